//! Leaderboard files: one CSV line per method and protocol, and per group where the protocol
//! has groups.
//!
//! Files of different people merge into one. Published figures of the thesis stand in the same
//! columns with their citation and without digests or intervals, since nobody measured them
//! here; their `origin` tells them from measured ones.
//!
//! # The file
//!
//! CSV in UTF-8 with the columns of [`COLUMNS`] in any order, told apart by name. `schema` is
//! [`SCHEMA`] on each line; it is raised when a column changes its meaning, and other values are
//! refused. `origin` is `measured` or `published`; measured lines have `protocol_digest` and
//! `data_digest`, published ones a `citation`. Each metric is an unweighted mean over images with
//! the bounds of its 95 % interval (`_low`, `_high`), `intervals` says how those were made. The
//! columns of the further metrics (`silog` to `sq_rel_2_high`) stand in a file only where a line has
//! them. An empty cell is a figure that nobody has. Numbers are in their shortest exact form, and
//! lines are sorted, so the same lines make the same file.

use std::collections::BTreeMap;
use std::fmt;
use std::io::{Read, Write};
use std::str::FromStr;

use crate::columns::{self, CsvError, cell};
use crate::metrics::{Metric, Metrics};
use crate::protocol::{Group, canonical};
use crate::published;
use crate::rows::{ModelRows, Row, RowsError, by_model};
use crate::statistics::{Interval, summarise};
use crate::tables::{Coverage, Source};
use crate::thesis::ThesisTable;

/// Version of the columns' meaning, written on each line.
pub const SCHEMA: u32 = 1;

/// Column names in the order in which they are written.
pub const COLUMNS: [&str; 60] = [
    "schema",
    "method",
    "origin",
    "citation",
    "variant",
    "model_hash",
    "protocol",
    "group",
    "abs_rel",
    "abs_rel_low",
    "abs_rel_high",
    "sq_rel",
    "sq_rel_low",
    "sq_rel_high",
    "rmse",
    "rmse_low",
    "rmse_high",
    "rmse_log",
    "rmse_log_low",
    "rmse_log_high",
    "a1",
    "a1_low",
    "a1_high",
    "a2",
    "a2_low",
    "a2_high",
    "a3",
    "a3_low",
    "a3_high",
    "rmse_pooled",
    "rmse_pooled_low",
    "rmse_pooled_high",
    "d1_all",
    "d1_all_low",
    "d1_all_high",
    "silog",
    "silog_low",
    "silog_high",
    "log10",
    "log10_low",
    "log10_high",
    "irmse",
    "irmse_low",
    "irmse_high",
    "mae",
    "mae_low",
    "mae_high",
    "sq_rel_2",
    "sq_rel_2_low",
    "sq_rel_2_high",
    "intervals",
    "images",
    "expected_images",
    "pixels",
    "floored_pixels",
    "protocol_digest",
    "data_digest",
    "runtime",
    "provider",
    "tool_version",
];

/// Index of `abs_rel` in [`COLUMNS`]; each of the fourteen figures from there on is followed by the
/// bounds of its interval.
const FIRST_FIGURE: usize = 8;

/// The figures: the seven metrics, pooled error, D1-all and the five further metrics.
const FIGURES: usize = 14;

/// Columns of the further metrics, which stand in a file only where a line has them.
fn further_columns() -> &'static [&'static str] {
    &COLUMNS[FIRST_FIGURE + 3 * 9..FIRST_FIGURE + 3 * FIGURES]
}

/// How intervals are made, as the lines say it.
const METHOD: &str = "95 % t interval, delete-one jackknife";

/// How earlier versions made them.
const OLD_METHOD: &str = "95 % percentile bootstrap";

/// Who says so.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Origin {
    /// Printed in the cited work.
    Published,
    /// Measured with this software.
    Measured,
}

impl fmt::Display for Origin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Published => "published",
            Self::Measured => "measured",
        })
    }
}

impl FromStr for Origin {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "published" => Ok(Self::Published),
            "measured" => Ok(Self::Measured),
            _ => Err(format!("{text:?} is neither published nor measured")),
        }
    }
}

/// One line.
#[derive(Clone, Debug, PartialEq)]
pub struct Entry {
    /// Name of the method or model.
    pub method: String,
    /// Measured or published.
    pub origin: Origin,
    /// Where published figures stand.
    pub citation: Option<String>,
    /// Training variant, if the model says so.
    pub variant: Option<String>,
    /// BLAKE3 of the model file.
    pub model_hash: Option<String>,
    /// Name of the protocol.
    pub protocol: String,
    /// Group of pixels, for protocols with groups.
    pub group: Option<Group>,
    /// Means over images in the order of [`Metric::ALL`]; published lines may lack some.
    pub metrics: [Option<f64>; 7],
    /// 95 % intervals of the means.
    pub intervals: [Option<Interval>; 7],
    /// Means of the further metrics in the order of [`FurtherMetric::ALL`](crate::FurtherMetric::ALL), where they were measured.
    pub further: [Option<f64>; 5],
    /// 95 % intervals of those means.
    pub further_intervals: [Option<Interval>; 5],
    /// Root of the squared error pooled over all pixels, metres.
    pub rmse_pooled: Option<f64>,
    /// 95 % interval of `rmse_pooled`.
    pub rmse_pooled_interval: Option<Interval>,
    /// D1-all in percent.
    pub d1_all: Option<f64>,
    /// 95 % interval of `d1_all`.
    pub d1_all_interval: Option<Interval>,
    /// How the intervals were made, in words.
    pub interval_method: Option<String>,
    /// Images scored.
    pub images: Option<u64>,
    /// Images of the complete test set.
    pub expected_images: Option<u64>,
    /// Pixels scored.
    pub pixels: Option<u64>,
    /// Pixels whose disparity was raised to the floor.
    pub floored_pixels: Option<u64>,
    /// Digest of the protocol; measured lines always have one.
    pub protocol_digest: Option<String>,
    /// Digest of the prepared set; measured lines always have one.
    pub data_digest: Option<String>,
    /// Inference library and version.
    pub runtime: Option<String>,
    /// Execution provider that really ran.
    pub provider: Option<String>,
    /// Version of the program that measured.
    pub tool_version: Option<String>,
}

/// Lines of all models among the rows that were measured under `protocol`, one per model, or
/// per model and group. `test_images` is how many the complete set has; a protocol whose ground
/// truth is known to cover fewer of them expects that many.
///
/// # Errors
/// Rows that do not belong together.
pub fn measured(rows: &[Row], protocol: &str, test_images: u64) -> Result<Vec<Entry>, RowsError> {
    let whole = Coverage {
        expected_images: test_images,
        source: Source::Unknown,
    };
    let expected_images = whole.under(protocol);
    let mut entries = Vec::new();
    for model in by_model(rows, protocol)? {
        entries.extend(lines(&model, expected_images));
    }
    Ok(entries)
}

/// The line of one model under one protocol, or its lines by group; `expected_images` is how many the
/// complete test set has under this protocol.
#[must_use]
pub fn lines(model: &ModelRows<'_>, expected_images: u64) -> Vec<Entry> {
    let mut entries = Vec::new();
    let context = model.context();
    let filled = |text: &str| (!text.is_empty()).then(|| text.to_owned());
    for group in std::iter::once(None).chain(Group::all().map(Some)) {
        let Some(summary) = summarise(&model.of_group(group)) else {
            continue;
        };
        entries.push(Entry {
            method: context.model.clone(),
            origin: Origin::Measured,
            citation: None,
            variant: context.variant.clone(),
            model_hash: filled(&context.model_hash),
            protocol: context.protocol.clone(),
            group,
            metrics: summary.mean.to_array().map(Some),
            intervals: match summary.intervals {
                Some(intervals) => intervals.map(Some),
                None => [None; 7],
            },
            further: summary
                .further
                .map_or([None; 5], |further| further.to_array().map(Some)),
            further_intervals: summary
                .further_intervals
                .map_or([None; 5], |intervals| intervals.map(Some)),
            rmse_pooled: Some(summary.pooled_rmse),
            rmse_pooled_interval: summary.pooled_rmse_interval,
            d1_all: summary.d1_all,
            d1_all_interval: summary.d1_all_interval,
            interval_method: summary
                .intervals
                .map(|_| format!("{METHOD} over {}", summary.clusters)),
            images: Some(summary.images),
            expected_images: Some(expected_images),
            pixels: Some(summary.pixels),
            floored_pixels: Some(summary.floored_pixels),
            protocol_digest: Some(context.protocol_digest.clone()),
            data_digest: Some(context.data_digest.clone()),
            runtime: filled(&model.distinct(|context| &context.runtime)),
            provider: filled(&model.distinct(|context| &context.provider)),
            tool_version: filled(&model.distinct(|context| &context.tool_version)),
        });
    }
    entries
}

/// Lines of all figures in the thesis' tables 3.1, 3.2 and 3.3, and of newer models.
pub fn published() -> Vec<Entry> {
    let bare = |method: &str, protocol: &str, citation: String| Entry {
        method: method.to_owned(),
        origin: Origin::Published,
        citation: Some(citation),
        variant: None,
        model_hash: None,
        protocol: protocol.to_owned(),
        group: None,
        metrics: [None; 7],
        intervals: [None; 7],
        further: [None; 5],
        further_intervals: [None; 5],
        rmse_pooled: None,
        rmse_pooled_interval: None,
        d1_all: None,
        d1_all_interval: None,
        interval_method: None,
        images: None,
        expected_images: None,
        pixels: None,
        floored_pixels: None,
        protocol_digest: None,
        data_digest: None,
        runtime: None,
        provider: None,
        tool_version: None,
    };
    let rows = ThesisTable::ALL
        .into_iter()
        .flat_map(published::rows)
        .map(|row| Entry {
            metrics: row.metrics,
            further: row.further,
            ..bare(&row.method, &row.protocol, row.citation())
        });
    let groups = published::groups().iter().map(|cell| {
        let mut entry = bare(&cell.method, &cell.protocol, cell.citation());
        entry.group = Some(cell.group);
        entry.metrics[Metric::Rmse as usize] = Some(cell.rmse);
        entry
    });
    rows.chain(groups).collect()
}

impl Entry {
    /// The seven means, if the line has them all.
    pub fn mean(&self) -> Option<Metrics> {
        let mut values = [0.0; 7];
        for (value, metric) in values.iter_mut().zip(self.metrics) {
            *value = metric?;
        }
        Some(Metrics::from_array(values))
    }

    /// First column in which two lines differ, with both values. Where intervals were made in two
    /// ways, that is the difference, and not their bounds.
    pub fn difference(&self, other: &Self) -> Option<String> {
        if self.is_old() != other.is_old() {
            let method = |entry: &Self| entry.interval_method.clone().unwrap_or_default();
            return Some(format!(
                "intervals: {:?} and {:?}",
                method(self),
                method(other)
            ));
        }
        columns::difference(&COLUMNS, &self.cells(), &other.cells())
    }

    /// Whether its intervals were made as earlier versions made them.
    fn is_old(&self) -> bool {
        let method = self.interval_method.as_deref();
        method.is_some_and(|method| method.starts_with(OLD_METHOD))
    }

    /// Whether it says the same as a line of today about the same measurement, less the further metrics
    /// or with intervals of another kind.
    fn gives_way_to(&self, other: &Self) -> bool {
        let fewer = self.further == [None; 5] && other.further != [None; 5];
        let plain = |entry: &Self| {
            let mut entry = entry.clone();
            if fewer {
                (entry.further, entry.further_intervals) = ([None; 5], [None; 5]);
            }
            entry
        };
        let (mine, theirs) = (plain(self), plain(other));
        if self.is_old() && !other.is_old() {
            mine.without_intervals() == theirs.without_intervals()
        } else {
            fewer && mine == theirs
        }
    }

    /// The same figures without what earlier versions computed otherwise.
    fn without_intervals(&self) -> Self {
        Self {
            intervals: [None; 7],
            further_intervals: [None; 5],
            rmse_pooled_interval: None,
            d1_all_interval: None,
            interval_method: None,
            ..self.clone()
        }
    }

    /// True if both lines are about the same model, protocol, data and device.
    pub fn same_measurement(&self, other: &Self) -> bool {
        self.key().cmp(&other.key()).is_eq()
    }

    /// The line as text, in the order of [`COLUMNS`]; empty where nobody has a figure.
    #[must_use]
    pub fn cells(&self) -> Vec<String> {
        let mut cells = vec![
            SCHEMA.to_string(),
            self.method.clone(),
            self.origin.to_string(),
            cell(self.citation.as_ref()),
            cell(self.variant.as_ref()),
            cell(self.model_hash.as_ref()),
            self.protocol.clone(),
            cell(self.group),
        ];
        let figures = self.metrics.iter().zip(&self.intervals).chain([
            (&self.rmse_pooled, &self.rmse_pooled_interval),
            (&self.d1_all, &self.d1_all_interval),
        ]);
        let figures = figures.chain(self.further.iter().zip(&self.further_intervals));
        for (figure, interval) in figures {
            cells.extend([
                cell(*figure),
                cell(interval.map(|interval| interval.low)),
                cell(interval.map(|interval| interval.high)),
            ]);
        }
        cells.extend([
            cell(self.interval_method.as_ref()),
            cell(self.images),
            cell(self.expected_images),
            cell(self.pixels),
            cell(self.floored_pixels),
            cell(self.protocol_digest.as_ref()),
            cell(self.data_digest.as_ref()),
            cell(self.runtime.as_ref()),
            cell(self.provider.as_ref()),
            cell(self.tool_version.as_ref()),
        ]);
        cells
    }

    /// What two lines about the same measurement have in common. Another device or runtime is
    /// another measurement.
    fn key(&self) -> impl Ord + '_ {
        (
            (
                &self.protocol,
                &self.protocol_digest,
                self.group,
                self.origin,
            ),
            (&self.method, &self.model_hash, &self.data_digest),
            (&self.runtime, &self.provider, &self.citation),
        )
    }
}

/// Writes a header and all lines in the order given.
///
/// # Errors
/// If the writer fails.
pub fn write(entries: &[Entry], writer: impl Write) -> Result<(), CsvError> {
    let has_further = entries.iter().any(|entry| entry.further != [None; 5]);
    let is_kept = |column: &&str| has_further || !further_columns().contains(column);
    let mut csv = strat_csv::Writer::new(writer);
    csv.write_record(COLUMNS.iter().filter(|column| is_kept(column)))?;
    for entry in entries {
        let cells = entry.cells().into_iter().zip(&COLUMNS);
        let cells = cells.filter(|(_, column)| is_kept(column));
        csv.write_record(cells.map(|(cell, _)| cell))?;
    }
    csv.flush()?;
    Ok(())
}

/// Reads what [`write()`] has written.
///
/// # Errors
/// Anything else than such a text, with line and column; a measured line without digests, or a
/// published one without citation.
pub fn read(reader: impl Read) -> Result<Vec<Entry>, CsvError> {
    columns::read(reader, &COLUMNS, further_columns(), |fields| {
        let filled = |column| fields.optional_text(column);
        let count = |column| fields.optional::<u64>(column, "empty or a whole number");
        if fields.value::<u32>("schema", "a whole number")? != SCHEMA {
            return Err(fields.error("schema", "1, the version that this program reads"));
        }
        let origin = fields.value("origin", "measured or published")?;
        match origin {
            Origin::Measured => {
                for column in ["protocol_digest", "data_digest"] {
                    fields.required(column)?;
                }
            }
            Origin::Published => {
                fields.required("citation")?;
            }
        }
        let mut figures = [None; FIGURES];
        let mut intervals = [None; FIGURES];
        for index in 0..FIGURES {
            let [value, low, high] = [0, 1, 2].map(|i| COLUMNS[FIRST_FIGURE + 3 * index + i]);
            figures[index] = fields.optional_measure(value)?;
            intervals[index] = match (
                fields.optional_measure(low)?,
                fields.optional_measure(high)?,
            ) {
                (Some(low), Some(high)) => Some(Interval { low, high }),
                (None, None) => None,
                (None, Some(_)) => return Err(fields.error(low, "the other bound of the interval")),
                (Some(_), None) => {
                    return Err(fields.error(high, "the other bound of the interval"));
                }
            };
        }
        let [a, b, c, d, e, f, g, rmse_pooled, d1_all, further @ ..] = figures;
        let metrics = [a, b, c, d, e, f, g];
        let [
            a,
            b,
            c,
            d,
            e,
            f,
            g,
            rmse_pooled_interval,
            d1_all_interval,
            further_intervals @ ..,
        ] = intervals;
        let intervals = [a, b, c, d, e, f, g];
        let (protocol, digest) = (fields.required("protocol")?, filled("protocol_digest"));
        let canonical = digest
            .as_ref()
            .and_then(|digest| canonical(&protocol, digest));
        let (protocol, protocol_digest) = match canonical {
            Some((name, digest)) => (name, Some(digest)),
            None => (protocol, digest),
        };
        Ok(Entry {
            method: fields.required("method")?,
            origin,
            citation: filled("citation"),
            variant: filled("variant"),
            model_hash: filled("model_hash"),
            protocol,
            group: fields.optional(
                "group",
                "empty or one of flat, human, vehicle, construction and object",
            )?,
            metrics,
            intervals,
            further,
            further_intervals,
            rmse_pooled,
            rmse_pooled_interval,
            d1_all,
            d1_all_interval,
            interval_method: filled("intervals"),
            images: count("images")?,
            expected_images: count("expected_images")?,
            pixels: count("pixels")?,
            floored_pixels: count("floored_pixels")?,
            protocol_digest,
            data_digest: filled("data_digest"),
            runtime: filled("runtime"),
            provider: filled("provider"),
            tool_version: filled("tool_version"),
        })
    })
}

/// Puts several files together, sorted by protocol, group, origin and method. Identical lines
/// become one; a line of an earlier version that differs in its intervals only gives way, and so does
/// one that lacks the further metrics only.
///
/// # Errors
/// [`CsvError::Conflict`] for two lines about the same measurement that differ, and
/// [`CsvError::Definition`] for measured lines whose protocols share a name but not a digest.
pub fn merge(parts: impl IntoIterator<Item = Vec<Entry>>) -> Result<Vec<Entry>, CsvError> {
    let mut merged: Vec<Entry> = parts.into_iter().flatten().collect();
    // Of lines about one measurement those of today, with all figures, come first.
    let rank = |entry: &Entry| (entry.is_old(), entry.further == [None; 5]);
    merged.sort_by(|a, b| (a.key(), rank(a)).cmp(&(b.key(), rank(b))));
    merged.dedup_by(|b, a| a.key() == b.key() && b.gives_way_to(a));
    for pair in merged.windows(2) {
        let [a, b] = pair else { continue };
        if a.key() != b.key() {
            continue;
        }
        if let Some(difference) = columns::difference(&COLUMNS, &a.cells(), &b.cells()) {
            return Err(CsvError::Conflict {
                what: format!("{} under {} ({})", a.method, a.protocol, a.origin),
                difference,
            });
        }
    }
    merged.dedup_by(|a, b| a.key() == b.key());
    let mut defined: BTreeMap<&str, (&Entry, &str)> = BTreeMap::new();
    for entry in &merged {
        let Some(digest) = &entry.protocol_digest else {
            continue;
        };
        let (first, known) = *defined.entry(&entry.protocol).or_insert((entry, digest));
        if known != digest {
            return Err(CsvError::Definition {
                protocol: entry.protocol.clone(),
                methods: format!("{} and {}", first.method, entry.method),
                digests: format!("{known:.12} and {digest:.12}"),
            });
        }
    }
    Ok(merged)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::FurtherMetrics;
    use crate::rows::tests::sample;

    fn text(entries: &[Entry]) -> String {
        let mut bytes = Vec::new();
        write(entries, &mut bytes).unwrap();
        String::from_utf8(bytes).unwrap()
    }

    fn rows() -> Vec<Row> {
        (0..8)
            .map(|i| {
                let image = format!("2011_09_26_drive_{:04}/{i:010}", i / 2);
                sample("StrAT", "eigen-80", &image, 0.1 + 0.01 * f64::from(i))
            })
            .collect()
    }

    fn measured_entries() -> Vec<Entry> {
        measured(&rows(), "eigen-80", 697).unwrap()
    }

    #[test]
    fn a_measured_line_has_its_whole_origin() {
        let entries = measured_entries();
        assert_eq!(entries.len(), 1);
        let entry = &entries[0];
        assert!((entry.mean().unwrap().abs_rel - 0.135).abs() < 1e-12);
        let interval = entry.intervals[0].unwrap();
        assert!(interval.low > 0.09 && interval.low < 0.135 && interval.high > 0.135);
        assert_eq!(
            (entry.images, entry.expected_images, entry.pixels),
            (Some(8), Some(697), Some(8000))
        );
        assert_eq!(
            entry.interval_method.as_deref(),
            Some("95 % t interval, delete-one jackknife over 4 drives")
        );
        assert_eq!(
            entry.protocol_digest,
            crate::protocol("eigen-80").map(|p| p.digest())
        );
        assert_eq!(entry.provider.as_deref(), Some("cpu"));
        assert!(measured(&rows(), "eigen-50", 697).unwrap().is_empty());
    }

    #[test]
    fn improved_ground_truth_is_complete_with_652_images() {
        let expected = |protocol: &str, images| {
            let rows = [sample(
                "m",
                protocol,
                "2011_09_26_drive_0002/0000000069",
                0.1,
            )];
            measured(&rows, protocol, images).unwrap()[0].expected_images
        };
        assert_eq!(expected("eigen-improved", 697), Some(652));
        assert_eq!(expected("eigen-80", 697), Some(697));
        // A rendered or partial list says itself how many there are.
        assert_eq!(expected("eigen-improved", 40), Some(40));
    }

    #[test]
    fn groups_have_lines_of_their_own() {
        let rows: Vec<Row> = [Group::Flat, Group::Object]
            .into_iter()
            .map(|group| {
                let mut row = sample("m", "semantic", "kitti2015/000000", 0.1);
                row.score.group = Some(group);
                row
            })
            .collect();
        let entries = measured(&rows, "semantic", 200).unwrap();
        let groups: Vec<_> = entries.iter().map(|entry| entry.group).collect();
        assert_eq!(groups, [Some(Group::Flat), Some(Group::Object)]);
        assert_eq!(entries[0].intervals, [None; 7]);
        assert!((entries[0].rmse_pooled.unwrap() - 5.0).abs() < 1e-12);
    }

    #[test]
    fn published_figures_are_marked_and_carry_no_digest() {
        let entries = published();
        let (thesis, newer): (Vec<&Entry>, Vec<&Entry>) = (entries.iter()).partition(|entry| {
            !entry.protocol.starts_with("eigen-kb") && entry.protocol != "eigen-affine-depth"
        });
        assert_eq!((thesis.len(), newer.len()), (6 + 17 + 15, 9));
        for entry in thesis {
            assert_eq!(entry.origin, Origin::Published);
            assert!(
                entry
                    .citation
                    .as_ref()
                    .is_some_and(|text| text.contains("MSc thesis"))
            );
            assert_eq!((&entry.protocol_digest, &entry.images), (&None, &None));
        }
        assert!(text(&entries[5..6]).contains("\n1,Ours - StrAT,published,"));
    }

    #[test]
    fn round_trip_and_merge() {
        let mut all = measured_entries();
        all.extend(published());
        let read_again = read(text(&all).as_bytes()).unwrap();
        assert_eq!(read_again, all);

        let merged = merge([all.clone(), read_again, measured_entries()]).unwrap();
        assert_eq!(merged.len(), all.len());
        assert_eq!(merge([merged.clone()]).unwrap(), merged);
        all.reverse();
        assert_eq!(
            merge([all]).unwrap(),
            merged,
            "order of the files must not matter"
        );

        // The same model on another device is another line.
        let mut cuda = measured_entries();
        cuda[0].provider = Some("cuda".to_owned());
        assert_eq!(merge([measured_entries(), cuda]).unwrap().len(), 2);

        let mut other = measured_entries();
        other[0].metrics[2] = Some(1.5);
        let error = merge([measured_entries(), other]).unwrap_err().to_string();
        assert!(
            error.starts_with("StrAT under eigen-80 (measured) occurs twice"),
            "{error}"
        );
        assert!(error.contains("rmse: "), "{error}");

        // Rules that share a name only.
        let mut redefined = measured_entries();
        redefined[0].method = "Other".to_owned();
        redefined[0].protocol_digest = Some("0123456789abcdef".to_owned());
        let error = merge([measured_entries(), redefined])
            .unwrap_err()
            .to_string();
        assert!(error.contains("two definitions of eigen-80"), "{error}");

        let newer = text(&measured_entries()).replacen("\n1,", "\n2,", 1);
        let error = read(newer.as_bytes()).unwrap_err().to_string();
        assert!(error.starts_with("line 2, column \"schema\""), "{error}");
    }

    /// Leaderboards of earlier versions are read on, and a line published again replaces its old
    /// intervals; other figures still contradict.
    #[test]
    fn lines_with_intervals_of_earlier_versions_give_way() {
        let mut old = measured_entries();
        old[0].interval_method =
            Some("95 % percentile bootstrap over 4 drives, 10000 resamples, seed 0".to_owned());
        old[0].intervals[0] = Some(Interval {
            low: 0.12,
            high: 0.15,
        });
        let read_again = read(text(&old).as_bytes()).unwrap();
        assert_eq!(read_again, old);
        for parts in [
            [old.clone(), measured_entries()],
            [measured_entries(), old.clone()],
        ] {
            assert_eq!(merge(parts).unwrap(), measured_entries());
        }
        let difference = old[0].difference(&measured_entries()[0]).unwrap();
        assert!(difference.starts_with("intervals: "), "{difference}");
        old[0].metrics[0] = Some(0.2);
        assert!(merge([old, measured_entries()]).is_err());
    }

    /// Further metrics are columns where a line has them, and a line without them gives way to the
    /// same one with them.
    #[test]
    fn further_metrics_are_columns_where_they_were_measured() {
        let plain = measured_entries();
        assert!(!text(&plain).contains("silog"));
        let mut rows = rows();
        for (row, silog) in rows.iter_mut().zip([10.0, 12.0].into_iter().cycle()) {
            row.score.further = Some(FurtherMetrics {
                silog,
                ..FurtherMetrics::from_array([1.0; 5])
            });
        }
        let full = measured(&rows, "eigen-80", 697).unwrap();
        assert_eq!(full[0].further[0], Some(11.0));
        let interval = full[0].further_intervals[0].unwrap();
        assert!(
            interval.low <= 11.0 && interval.high >= 11.0,
            "{interval:?}"
        );
        let mut all = full.clone();
        all.extend(published());
        assert!(text(&all).contains(",silog,silog_low,silog_high,log10,"));
        assert_eq!(read(text(&all).as_bytes()).unwrap(), all);
        for parts in [[plain.clone(), full.clone()], [full.clone(), plain.clone()]] {
            assert_eq!(merge(parts).unwrap(), full);
        }
        // Metrics that only some images have are those of none.
        rows[0].score.further = None;
        assert_eq!(measured(&rows, "eigen-80", 697).unwrap(), plain);
        let mut other = plain;
        other[0].metrics[0] = Some(0.5);
        assert!(merge([other, full]).is_err());
    }

    #[test]
    fn a_measured_line_without_digest_is_refused() {
        let mut entries = measured_entries();
        entries[0].data_digest = None;
        let error = read(text(&entries).as_bytes()).unwrap_err().to_string();
        assert!(
            error.starts_with("line 2, column \"data_digest\""),
            "{error}"
        );
        let mut entries = published();
        entries[0].citation = None;
        let error = read(text(&entries).as_bytes()).unwrap_err().to_string();
        assert!(error.starts_with("line 2, column \"citation\""), "{error}");
        let low = measured_entries()[0].intervals[0].unwrap().low.to_string();
        let half = text(&measured_entries()).replacen(&format!(",{low},"), ",,", 1);
        let error = read(half.as_bytes()).unwrap_err().to_string();
        assert!(
            error.starts_with("line 2, column \"abs_rel_low\""),
            "{error}"
        );
    }

    #[test]
    fn metrics_stand_where_the_header_says() {
        for (index, metric) in Metric::ALL.into_iter().enumerate() {
            assert_eq!(COLUMNS[FIRST_FIGURE + 3 * index], metric.name());
        }
        assert_eq!(measured_entries()[0].cells().len(), COLUMNS.len());
    }
}
