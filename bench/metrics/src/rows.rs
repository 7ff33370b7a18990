//! `rows.csv`: one line per model, protocol, image and, where the protocol has groups, group.
//!
//! Tables, intervals and leaderboard lines are made of these lines and of nothing else. Numbers
//! are written in their shortest exact form, so reading gives back the very values. What only some
//! runs measure has columns only where a row has it: further metrics, scale and shift.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{Read, Write};

use crate::columns::{self, CsvError, cell};
use crate::evaluate::{Fit, ImageScore};
use crate::metrics::{FurtherMetric, FurtherMetrics, Metrics};
use crate::protocol::{Group, canonical};

/// Column names in the order in which they are written. Of these, `silog` to `sq_rel_2` stand in a file
/// only where the further metrics were measured, `scale` and `shift` only where rows were aligned.
pub const COLUMNS: [&str; 30] = [
    "model",
    "model_hash",
    "variant",
    "protocol",
    "protocol_digest",
    "data_digest",
    "split",
    "image",
    "group",
    "abs_rel",
    "sq_rel",
    "rmse",
    "rmse_log",
    "a1",
    "a2",
    "a3",
    "d1_all",
    "silog",
    "log10",
    "irmse",
    "mae",
    "sq_rel_2",
    "sum_squared_error",
    "pixels",
    "floored_pixels",
    "scale",
    "shift",
    "runtime",
    "provider",
    "tool_version",
];

/// Columns of the further metrics.
fn further_columns() -> [&'static str; 5] {
    FurtherMetric::ALL.map(FurtherMetric::name)
}

/// Columns of the numbers of an alignment.
const FIT_COLUMNS: [&str; 2] = ["scale", "shift"];

/// What all lines of one model under one protocol share.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RowContext {
    /// Name under which the model appears in tables.
    pub model: String,
    /// BLAKE3 of the model file; for a baseline without a file, a text that identifies it.
    pub model_hash: String,
    /// Training variant, if the model says so.
    pub variant: Option<String>,
    /// Name of the protocol.
    pub protocol: String,
    /// Digest of the protocol.
    pub protocol_digest: String,
    /// Digest of the prepared set.
    pub data_digest: String,
    /// Split of the prepared set.
    pub split: String,
    /// Inference library and version.
    pub runtime: String,
    /// Execution provider that really ran, such as `cpu` or `cuda`.
    pub provider: String,
    /// Version of the program that measured.
    pub tool_version: String,
}

impl RowContext {
    /// Name and seed of a model called `NAME@SEED`.
    #[must_use]
    pub fn seed(&self) -> Option<(&str, &str)> {
        let (name, seed) = self.model.rsplit_once('@')?;
        (!name.is_empty() && !seed.is_empty()).then_some((name, seed))
    }
}

/// One line of `rows.csv`.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Model, protocol and data.
    pub context: RowContext,
    /// Image id, such as `2011_09_26_drive_0001/0000000005` or `kitti2015/000006`.
    pub image: String,
    /// What was measured.
    pub score: ImageScore,
}

impl Row {
    /// A line of the scores of one image.
    pub fn new(context: &RowContext, image: impl Into<String>, score: ImageScore) -> Self {
        Self {
            context: context.clone(),
            image: image.into(),
            score,
        }
    }

    /// What no two lines may have in common: model, protocol, image and group.
    fn key(&self) -> (&str, &str, &str, Option<Group>) {
        let RowContext {
            model, protocol, ..
        } = &self.context;
        (model, protocol, &self.image, self.score.group)
    }

    /// The line as text, in the order of [`COLUMNS`]; empty where there is nothing.
    #[must_use]
    pub fn cells(&self) -> Vec<String> {
        let c = &self.context;
        let mut cells = vec![
            c.model.clone(),
            c.model_hash.clone(),
            c.variant.clone().unwrap_or_default(),
            c.protocol.clone(),
            c.protocol_digest.clone(),
            c.data_digest.clone(),
            c.split.clone(),
            self.image.clone(),
            cell(self.score.group),
        ];
        cells.extend(self.score.metrics.to_array().map(|value| value.to_string()));
        cells.push(cell(self.score.d1_all));
        let further = self.score.further.map(FurtherMetrics::to_array);
        cells.extend((0..5).map(|index| cell(further.map(|values| values[index]))));
        cells.extend([
            self.score.sum_squared_error.to_string(),
            self.score.pixels.to_string(),
            self.score.floored_pixels.to_string(),
            cell(self.score.fit.map(|fit| fit.scale)),
            cell(self.score.fit.map(|fit| fit.shift)),
            c.runtime.clone(),
            c.provider.clone(),
            c.tool_version.clone(),
        ]);
        cells
    }
}

/// Which of [`COLUMNS`] a file of these rows has.
#[must_use]
pub fn columns_of(rows: &[Row]) -> Vec<&'static str> {
    let has_further = rows.iter().any(|row| row.score.further.is_some());
    let has_fit = rows.iter().any(|row| row.score.fit.is_some());
    let is_there = |column: &&str| {
        (has_further || !further_columns().contains(column))
            && (has_fit || !FIT_COLUMNS.contains(column))
    };
    COLUMNS.into_iter().filter(is_there).collect()
}

/// Writes a header and all rows in the order given, without columns that would be empty because
/// nothing of the kind was measured.
///
/// # Errors
/// If the writer fails.
pub fn write(rows: &[Row], writer: impl Write) -> Result<(), CsvError> {
    let columns = columns_of(rows);
    let mut csv = strat_csv::Writer::new(writer);
    csv.write_record(&columns)?;
    for row in rows {
        let cells = row.cells().into_iter().zip(COLUMNS);
        let cells = cells.filter(|(_, column)| columns.contains(column));
        csv.write_record(cells.map(|(cell, _)| cell))?;
    }
    csv.flush()?;
    Ok(())
}

/// Writes a header with every column and rows, so that any row may follow by [`append`].
///
/// # Errors
/// If the writer fails.
pub fn begin(rows: &[Row], mut writer: impl Write) -> Result<(), CsvError> {
    let mut csv = strat_csv::Writer::new(&mut writer);
    csv.write_record(COLUMNS)?;
    csv.flush()?;
    drop(csv);
    append(rows, writer)
}

/// Writes rows with every column and without a header, behind what [`begin`] wrote.
///
/// # Errors
/// If the writer fails.
pub fn append(rows: &[Row], writer: impl Write) -> Result<(), CsvError> {
    let mut csv = strat_csv::Writer::new(writer);
    for row in rows {
        csv.write_record(row.cells())?;
    }
    csv.flush()?;
    Ok(())
}

/// Reads what [`write()`] has written, also without the optional columns. Names of protocols become the canonical ones
/// ([`ProtocolName`](crate::ProtocolName)), digests with them; rows that then are the same are one.
///
/// # Errors
/// Anything else than such a text, with line and column.
pub fn read(reader: impl Read) -> Result<Vec<Row>, CsvError> {
    let optional = [&further_columns()[..], &FIT_COLUMNS].concat();
    let mut rows = columns::read(reader, &COLUMNS, &optional, |fields| {
        let context = RowContext {
            model: fields.required("model")?,
            model_hash: fields.text("model_hash"),
            variant: fields.optional_text("variant"),
            protocol: fields.required("protocol")?,
            protocol_digest: fields.required("protocol_digest")?,
            data_digest: fields.required("data_digest")?,
            split: fields.text("split"),
            runtime: fields.text("runtime"),
            provider: fields.text("provider"),
            tool_version: fields.text("tool_version"),
        };
        let metrics = Metrics {
            abs_rel: fields.measure("abs_rel")?,
            sq_rel: fields.measure("sq_rel")?,
            rmse: fields.measure("rmse")?,
            rmse_log: fields.measure("rmse_log")?,
            a1: fields.measure("a1")?,
            a2: fields.measure("a2")?,
            a3: fields.measure("a3")?,
        };
        let count = "a whole number";
        let pixels = fields.value("pixels", count)?;
        if pixels == 0 {
            return Err(fields.error("pixels", "a whole number above 0"));
        }
        Ok(Row {
            context,
            image: fields.required("image")?,
            score: ImageScore {
                group: fields.optional(
                    "group",
                    "empty or one of flat, human, vehicle, construction and object, or a distance such as 5-10m",
                )?,
                metrics,
                further: (fields.measures(further_columns())?).map(FurtherMetrics::from_array),
                d1_all: fields.optional_measure("d1_all")?,
                sum_squared_error: fields.measure("sum_squared_error")?,
                pixels,
                floored_pixels: fields.value("floored_pixels", count)?,
                fit: (fields.numbers(FIT_COLUMNS)?).map(|[scale, shift]| Fit { scale, shift }),
            },
        })
    })?;
    name_canonically(&mut rows);
    Ok(rows)
}

fn name_canonically(rows: &mut Vec<Row>) {
    let mut known: BTreeMap<(String, String), Option<(String, String)>> = BTreeMap::new();
    let mut renamed = false;
    for RowContext {
        protocol,
        protocol_digest,
        ..
    } in rows.iter_mut().map(|row| &mut row.context)
    {
        let canonical = known
            .entry((protocol.clone(), protocol_digest.clone()))
            .or_insert_with(|| canonical(protocol, protocol_digest));
        if let Some((name, digest)) = canonical {
            protocol.clone_from(name);
            protocol_digest.clone_from(digest);
            renamed = true;
        }
    }
    if renamed {
        let mut seen = BTreeSet::new();
        rows.retain(|row| seen.insert(row.cells()));
    }
}

/// Puts rows of several files together, sorted by model, protocol, image and group, so that the
/// parts of a divided run merge into the very lines of an undivided one. Identical lines
/// become one.
///
/// # Errors
/// [`CsvError::Conflict`] for two lines about the same image that differ.
pub fn merge(parts: impl IntoIterator<Item = Vec<Row>>) -> Result<Vec<Row>, CsvError> {
    let mut merged: Vec<Row> = parts.into_iter().flatten().collect();
    merged.sort_by(|a, b| a.key().cmp(&b.key()));
    for pair in merged.windows(2) {
        let [a, b] = pair else { continue };
        if a.key() != b.key() {
            continue;
        }
        if let Some(difference) = columns::difference(&COLUMNS, &a.cells(), &b.cells()) {
            return Err(CsvError::Conflict {
                what: format!(
                    "image {} of model {} under {}",
                    a.image, a.context.model, a.context.protocol
                ),
                difference,
            });
        }
    }
    merged.dedup_by(|a, b| a.key() == b.key());
    Ok(merged)
}

/// Why rows cannot stand in one table.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum RowsError {
    /// Rows under one model name that belong to different models, data or rules.
    #[error(
        "the rows of model {model} under {protocol} have two values of {what}: {first:?} and \
         {second:?}; give the two runs different model names or leave one out"
    )]
    Mixed {
        /// Model name.
        model: String,
        /// Protocol name.
        protocol: String,
        /// Column that differs.
        what: &'static str,
        /// Value of the first row.
        first: String,
        /// Another value.
        second: String,
    },
    /// An image that was counted twice.
    #[error(
        "image {image} occurs twice among the rows of model {model} under {protocol}; merge the \
         files instead of joining them"
    )]
    Duplicate {
        /// Model name.
        model: String,
        /// Protocol name.
        protocol: String,
        /// Image id.
        image: String,
    },
}

/// All rows of one model under one protocol: never empty, one model file, one data set, one
/// definition of the protocol, no image twice, sorted by image and group.
#[derive(Clone, Debug)]
pub struct ModelRows<'a> {
    rows: Vec<&'a Row>,
}

impl<'a> ModelRows<'a> {
    /// Rows of one model under one protocol, brought into order.
    ///
    /// # Errors
    /// There are none that belong together: two models, definitions or data sets, or an image twice.
    ///
    /// # Panics
    /// Without any row.
    pub fn new(mut rows: Vec<&'a Row>) -> Result<Self, RowsError> {
        assert!(!rows.is_empty(), "rows of a model are never empty");
        rows.sort_by(|a, b| a.key().cmp(&b.key()));
        let model = Self { rows };
        model.check()?;
        Ok(model)
    }

    fn check(&self) -> Result<(), RowsError> {
        let first = self.context();
        for row in &self.rows {
            let other = &row.context;
            fn variant(context: &RowContext) -> &str {
                context.variant.as_deref().unwrap_or_default()
            }
            for (what, a, b) in [
                ("model_hash", &*first.model_hash, &*other.model_hash),
                ("variant", variant(first), variant(other)),
                (
                    "protocol_digest",
                    &first.protocol_digest,
                    &other.protocol_digest,
                ),
                ("data_digest", &first.data_digest, &other.data_digest),
                ("split", &first.split, &other.split),
            ] {
                if a != b {
                    return Err(RowsError::Mixed {
                        model: first.model.clone(),
                        protocol: first.protocol.clone(),
                        what,
                        first: a.to_owned(),
                        second: b.to_owned(),
                    });
                }
            }
        }
        if let Some(pair) = self
            .rows
            .windows(2)
            .find(|pair| pair[0].key() == pair[1].key())
        {
            return Err(RowsError::Duplicate {
                model: first.model.clone(),
                protocol: first.protocol.clone(),
                image: pair[0].image.clone(),
            });
        }
        Ok(())
    }

    /// The rows.
    pub fn rows(&self) -> &[&'a Row] {
        &self.rows
    }

    /// What the rows share. Runtime, provider and tool version may differ from row to row, see
    /// [`ModelRows::distinct`].
    pub fn context(&self) -> &'a RowContext {
        &self.rows[0].context
    }

    /// Number of images.
    pub fn images(&self) -> u64 {
        let images: BTreeSet<&str> = self.rows.iter().map(|row| row.image.as_str()).collect();
        images.len() as u64
    }

    /// Rows of one group.
    pub fn of_group(&self, group: Option<Group>) -> Vec<&'a Row> {
        let members = self.rows.iter().filter(|row| row.score.group == group);
        members.copied().collect()
    }

    /// Values that may differ among the parts of a divided run, sorted and joined by ` + `.
    pub fn distinct(&self, value: impl Fn(&RowContext) -> &str) -> String {
        let values: BTreeSet<&str> = self.rows.iter().map(|row| value(&row.context)).collect();
        values.into_iter().collect::<Vec<_>>().join(" + ")
    }
}

/// The rows of each model under a protocol, models in the order of their first row.
///
/// # Errors
/// Rows that do not belong together, or an image twice.
pub fn by_model<'a>(rows: &'a [Row], protocol: &str) -> Result<Vec<ModelRows<'a>>, RowsError> {
    let mut models: Vec<Vec<&'a Row>> = Vec::new();
    let mut indices = BTreeMap::new();
    for row in rows.iter().filter(|row| row.context.protocol == protocol) {
        let index = *indices
            .entry(row.context.model.as_str())
            .or_insert_with(|| {
                models.push(Vec::new());
                models.len() - 1
            });
        models[index].push(row);
    }
    models.into_iter().map(ModelRows::new).collect()
}

#[cfg(test)]
pub(crate) mod tests {
    use proptest::prelude::*;

    use super::*;

    /// A row with plain values that depend on a number.
    pub(crate) fn sample(model: &str, protocol: &str, image: &str, value: f64) -> Row {
        let context = RowContext {
            model: model.to_owned(),
            model_hash: format!("hash of {model}"),
            variant: None,
            protocol: protocol.to_owned(),
            protocol_digest: crate::protocol(protocol).map_or("digest".to_owned(), |p| p.digest()),
            data_digest: "0f1e2d3c4b5a69788796a5b4c3d2e1f0".to_owned(),
            split: "kitti".to_owned(),
            runtime: "embedded".to_owned(),
            provider: "cpu".to_owned(),
            tool_version: "0.1.0".to_owned(),
        };
        let score = ImageScore {
            group: None,
            metrics: Metrics {
                abs_rel: value,
                sq_rel: 10.0 * value,
                rmse: 50.0 * value,
                rmse_log: 2.0 * value,
                a1: 1.0 - value,
                a2: 1.0 - value / 2.0,
                a3: 1.0 - value / 4.0,
            },
            further: None,
            d1_all: None,
            sum_squared_error: 1000.0 * (50.0 * value).powi(2),
            pixels: 1000,
            floored_pixels: 0,
            fit: None,
        };
        Row::new(&context, image, score)
    }

    fn text(rows: &[Row]) -> String {
        let mut bytes = Vec::new();
        write(rows, &mut bytes).unwrap();
        String::from_utf8(bytes).unwrap()
    }

    #[test]
    fn a_line_looks_like_this() {
        let mut row = sample("StrAT, seed 1", "semantic", "kitti2015/000006", 0.1);
        row.context.protocol_digest = "abc".to_owned();
        row.score.group = Some(Group::Human);
        row.score.d1_all = Some(30.25);
        assert_eq!(
            text(&[row]),
            "model,model_hash,variant,protocol,protocol_digest,data_digest,split,image,group,\
             abs_rel,sq_rel,rmse,rmse_log,a1,a2,a3,d1_all,sum_squared_error,pixels,\
             floored_pixels,runtime,provider,tool_version\n\
             \"StrAT, seed 1\",\"hash of StrAT, seed 1\",,semantic,abc,\
             0f1e2d3c4b5a69788796a5b4c3d2e1f0,kitti,kitti2015/000006,human,\
             0.1,1,5,0.2,0.9,0.95,0.975,30.25,25000,1000,0,embedded,cpu,0.1.0\n"
        );
    }

    /// What only some runs measure has columns only where it was measured.
    #[test]
    fn columns_stand_where_something_was_measured() {
        let plain = sample("m", "p", "a", 0.1);
        let mut aligned = sample("m", "p-affine-depth", "a", 0.1);
        aligned.score.fit = Some(Fit {
            scale: -0.5,
            shift: 3.0,
        });
        aligned.score.further = Some(FurtherMetrics::from_array([1.0, 2.0, 3.0, 4.0, 5.0]));
        let both = text(&[plain.clone(), aligned.clone()]);
        assert!(both.contains("d1_all,silog,log10,irmse,mae,sq_rel_2,sum_squared_error"));
        assert!(
            both.contains(",floored_pixels,scale,shift,runtime"),
            "{both}"
        );
        assert!(both.contains(",,,,,,25000,1000,0,,,embedded"), "{both}");
        assert!(
            both.contains(",,1,2,3,4,5,25000,1000,0,-0.5,3,embedded"),
            "{both}"
        );
        let rows = [plain.clone(), aligned];
        assert_eq!(read(both.as_bytes()).unwrap(), rows);
        assert!(!text(&[plain]).contains("shift"));
        let half = both.replace(",-0.5,3,", ",-0.5,,");
        let error = read(half.as_bytes()).unwrap_err().to_string();
        assert!(error.contains("line 3, column \"shift\""), "{error}");
        let not = both.replace(",-0.5,", ",inf,");
        let error = read(not.as_bytes()).unwrap_err().to_string();
        assert!(error.contains("\"inf\" is not a finite number"), "{error}");
        let metric = both.replace(",1,2,3,4,5,", ",1,-2,3,4,5,");
        let error = read(metric.as_bytes()).unwrap_err().to_string();
        assert!(error.contains("column \"log10\""), "{error}");
    }

    proptest! {
        #[test]
        fn round_trip_is_exact(
            model in "[ -~\\n\"é]{1,12}",
            variant in proptest::option::of("[a-z,\"]{1,8}"),
            provider in ".{0,8}",
            values in proptest::array::uniform8(0.0..1e12_f64),
            d1 in proptest::option::of(0.0..100.0_f64),
            counts in (1..u64::MAX, 0..u64::MAX),
            group in proptest::option::of(proptest::sample::select(Group::all().collect::<Vec<_>>())),
            further in proptest::option::of(proptest::array::uniform5(0.0..1e6_f64)),
            fit in proptest::option::of((-1e6..1e6_f64, -1e6..1e6_f64)),
        ) {
            let mut row = sample(&model, "p", "2011_09_26_drive_0001/0000000005", 0.5);
            row.context.variant = variant;
            row.context.provider = provider;
            let [a, b, c, d, e, f, g, squared] = values;
            row.score = ImageScore {
                group,
                metrics: Metrics::from_array([a, b, c, d, e, f, g]),
                further: further.map(FurtherMetrics::from_array),
                d1_all: d1,
                sum_squared_error: squared,
                pixels: counts.0,
                floored_pixels: counts.1,
                fit: fit.map(|(scale, shift)| Fit { scale, shift }),
            };
            let rows = [row];
            prop_assert_eq!(&read(text(&rows).as_bytes()).unwrap()[..], &rows[..]);
            let mut open = Vec::new();
            begin(&[], &mut open).unwrap();
            append(&rows, &mut open).unwrap();
            prop_assert_eq!(&read(open.as_slice()).unwrap()[..], &rows[..]);
        }

        #[test]
        fn no_text_makes_the_reader_panic(text in ".{0,300}", cells in ".{0,80}") {
            let _ = read(text.as_bytes());
            let _ = read(format!("{}\n{cells}\n", COLUMNS.join(",")).as_bytes());
        }
    }

    /// A row under an old spelling is one under the canonical name, and doubled ones are one.
    #[test]
    fn old_names_of_protocols_are_read_as_the_canonical_ones() {
        let rules = crate::protocol("eigen-80-pp-median").unwrap();
        let named = |name: &str| {
            let definition = crate::Protocol {
                name: name.to_owned(),
                ..rules.clone()
            };
            let mut row = sample("m", name, "d/0", 0.1);
            row.context.protocol_digest = definition.digest();
            row
        };
        let new = named("eigen-80-pp-median");
        let rows = [named("eigen-80-median-pp"), new.clone()];
        assert_eq!(read(text(&rows).as_bytes()).unwrap(), [new]);
        // What was measured under other rules keeps its name.
        let mut other = named("eigen-80-median-pp");
        other.context.protocol_digest = "other".to_owned();
        let rows = [other];
        assert_eq!(read(text(&rows).as_bytes()).unwrap(), rows);
    }

    #[test]
    fn columns_may_stand_in_any_order() {
        let rows = [sample("m", "p", "i", 0.3)];
        let turned: String = text(&rows)
            .lines()
            .map(|line| line.rsplit(',').collect::<Vec<_>>().join(",") + "\n")
            .collect();
        assert_eq!(read(turned.as_bytes()).unwrap(), rows);
    }

    #[test]
    fn errors_name_line_and_column() {
        let good = text(&[sample("m", "p", "i", 0.3), sample("m", "p", "j", 0.25)]);
        let error = |text: String| read(text.as_bytes()).unwrap_err().to_string();
        assert_eq!(
            error(good.replace(",12.5,", ",NaN,")),
            "line 3, column \"rmse\": \"NaN\" is not a finite number from 0 up"
        );
        assert_eq!(
            error(good.replacen(",1000,", ",0,", 1)),
            "line 2, column \"pixels\": \"0\" is not a whole number above 0"
        );
        assert_eq!(
            error(good.replacen("\nm,", "\n,", 1)),
            "line 2, column \"model\": \"\" is not a text, which must not be empty"
        );
        let missing = error(good.replace(",pixels", ",pixel"));
        assert!(
            missing.starts_with("line 1 has the column \"pixel\""),
            "{missing}"
        );
        let twice = error(good.replace("split,", "model,"));
        assert!(
            twice.starts_with("line 1 has the column \"model\""),
            "{twice}"
        );
        let absent = error(
            good.lines()
                .map(|l| l.rsplit_once(',').unwrap().0.to_owned() + "\n")
                .collect(),
        );
        assert!(
            absent.starts_with("line 1 has no column \"tool_version\""),
            "{absent}"
        );
        // A cut file.
        let cut = error(good[..good.len() - 20].to_owned());
        assert!(cut.contains("line: 3"), "{cut}");
        assert!(error(String::new()).starts_with("line 1 has no column"));
    }

    #[test]
    fn parts_merge_into_the_whole() {
        let whole: Vec<Row> = (0..10)
            .map(|i| sample("m", "p", &format!("d/{i:03}"), f64::from(i)))
            .collect();
        let odd: Vec<Row> = whole.iter().skip(1).step_by(2).cloned().collect();
        let even: Vec<Row> = whole.iter().step_by(2).cloned().collect();
        // The first image is in both.
        let again = vec![whole[0].clone()];
        assert_eq!(merge([odd, again, even]).unwrap(), whole);

        let mut other = whole[3].clone();
        other.score.metrics.rmse = 7.5;
        assert_eq!(
            merge([whole, vec![other]]).unwrap_err().to_string(),
            "image d/003 of model m under p occurs twice with different contents (rmse: \"150\" \
             and \"7.5\"); the files were not made by the same run, so decide which one is right \
             and leave the other out"
        );
    }

    #[test]
    fn rows_that_do_not_belong_together_are_refused() {
        let a = sample("m", "p", "a", 0.1);
        let mut b = sample("m", "p", "b", 0.1);
        b.context.provider = "cuda".to_owned();
        let rows = [
            a.clone(),
            b.clone(),
            sample("n", "p", "a", 0.1),
            sample("m", "q", "a", 0.1),
        ];
        let models = by_model(&rows, "p").unwrap();
        let names: Vec<&str> = models.iter().map(|m| m.context().model.as_str()).collect();
        assert_eq!((names, models[0].images()), (vec!["m", "n"], 2));
        assert_eq!(
            models[0].distinct(|context| &context.provider),
            "cpu + cuda"
        );

        b.context.model_hash = "other".to_owned();
        let error = by_model(&[a.clone(), b], "p").unwrap_err();
        assert!(
            matches!(
                error,
                RowsError::Mixed {
                    what: "model_hash",
                    ..
                }
            ),
            "{error}"
        );
        let error = by_model(&[a.clone(), a], "p").unwrap_err();
        assert!(matches!(error, RowsError::Duplicate { .. }), "{error}");
    }
}
