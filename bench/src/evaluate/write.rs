//! Which tables a prepared set can fill, and the files a run leaves behind.
//!
//! The contents of tables are [`strat_metrics::tables`]'s: a pure function of rows. This module
//! decides what is asked of a set and writes `rows.csv`, `leaderboard.csv`, the tables in four
//! formats, `failures.csv` and `run.yaml`.

use std::{
    collections::HashMap,
    path::{Path, PathBuf},
};

use serde::{Deserialize, Serialize};
use strat_metrics::{
    GroundTruthKind, Grouping, Metric, Protocol, Row, leaderboard, rows,
    statistics::Bootstrap,
    tables::{self, Coverage, Scale, Table, TableError, ThesisTable},
};
use strat_splits::Role;
use strat_store::{
    files,
    set::{Content, Count, PreparedSet, Sample},
    shard::Shard,
    yaml,
};

use crate::evaluate::Failure;

/// What `--table` asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum TableChoice {
    /// KITTI split: the seven metrics.
    #[value(name = "3.1")]
    Table31,
    /// KITTI split: errors by semantic group.
    #[value(name = "3.2")]
    Table32,
    /// Eigen split: the seven metrics with caps of 80 m and 50 m.
    #[value(name = "3.3")]
    Table33,
    /// Make3D: the figures beside the pictures of figure 3.6.
    #[value(name = "make3d")]
    Make3d,
    /// Whatever the prepared set offers.
    All,
}

/// Why a set cannot fill a table.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PlanError {
    /// The table belongs to the other split.
    #[error(
        "table {table} is about the {needed} split, but the set was prepared for the {found} \
         split; prepare the data with `prep {needed}` or ask for table {instead}"
    )]
    WrongSplit {
        /// The table asked for.
        table: ThesisTable,
        /// Its split.
        needed: Content,
        /// What the set was made of.
        found: Content,
        /// A table of the set's split.
        instead: ThesisTable,
    },
    /// The thesis has no table for such a set.
    #[error(
        "the thesis has no table for a set of {found}; prepare KITTI with `prep kitti` or `prep eigen`, or \
         evaluate this set under a protocol by name (`--protocol`)"
    )]
    NoTable {
        /// What the set was made of.
        found: Content,
    },
    /// No label images.
    #[error(
        "table 3.2 needs semantic labels, and none of the test images of this set has any; \
         prepare the data with `prep kitti --semantics DIR`"
    )]
    NoLabels,
    /// Nothing to test on.
    #[error("the prepared set has no test images (of {expected} expected)")]
    NoTestImages {
        /// How many the split has.
        expected: u64,
    },
    /// No such protocol, or a file that is none: a sentence.
    #[error("{0}")]
    Protocol(String),
    /// The protocol's ground truth is not in the set.
    #[error(
        "protocol {name} compares with {truth} ground truth, which no test image of this set (`{found}`) \
         has; prepare the data with `{remedy}`"
    )]
    WrongTruth {
        /// The protocol.
        name: String,
        /// Its ground truth in words.
        truth: &'static str,
        /// What the set was made of.
        found: Content,
        /// The command that makes sets with it.
        remedy: &'static str,
    },
}

/// What a run measures.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// Tables to write, in thesis order.
    pub tables: Vec<ThesisTable>,
    /// Protocols to evaluate: those of the tables, then those asked for by name.
    pub protocols: Vec<Protocol>,
    /// Sentences about tables that were left out of `all`.
    pub left_out: Vec<String>,
}

/// Decides what to measure.
///
/// # Errors
/// The set cannot serve what was asked for.
pub fn plan(
    choice: TableChoice,
    extra_protocols: &[String],
    content: Content,
    samples: &[Sample],
    count: Count,
) -> Result<Plan, PlanError> {
    if samples.is_empty() {
        return Err(PlanError::NoTestImages {
            expected: count.expected,
        });
    }
    let has_labels = samples.iter().any(|sample| sample.semantic.is_some());
    let own: &[ThesisTable] = match content {
        Content::Kitti => &[ThesisTable::Table31, ThesisTable::Table32],
        Content::Eigen => &[ThesisTable::Table33],
        Content::Make3d => &[ThesisTable::Make3d],
        Content::Pairs | Content::Cityscapes => &[],
    };
    let wanted = match choice {
        TableChoice::Table31 => Some(ThesisTable::Table31),
        TableChoice::Table32 => Some(ThesisTable::Table32),
        TableChoice::Table33 => Some(ThesisTable::Table33),
        TableChoice::Make3d => Some(ThesisTable::Make3d),
        TableChoice::All => None,
    };
    let mut plan = Plan {
        tables: Vec::new(),
        protocols: Vec::new(),
        left_out: Vec::new(),
    };
    match wanted {
        Some(table) if !own.contains(&table) => {
            return Err(match own.first() {
                Some(&instead) => PlanError::WrongSplit {
                    table,
                    needed: match table {
                        ThesisTable::Table31 | ThesisTable::Table32 => Content::Kitti,
                        ThesisTable::Table33 => Content::Eigen,
                        ThesisTable::Make3d => Content::Make3d,
                    },
                    found: content,
                    instead,
                },
                None => PlanError::NoTable { found: content },
            });
        }
        Some(ThesisTable::Table32) if !has_labels => return Err(PlanError::NoLabels),
        Some(table) => plan.tables.push(table),
        None => {
            for &table in own {
                if table == ThesisTable::Table32 && !has_labels {
                    plan.left_out
                        .push(format!("left out: {}", PlanError::NoLabels));
                } else {
                    plan.tables.push(table);
                }
            }
        }
    }
    let of_tables = plan
        .tables
        .iter()
        .flat_map(|table| table.protocols().iter().copied())
        .map(str::to_owned)
        .collect::<Vec<_>>();
    for name in of_tables.iter().chain(extra_protocols) {
        let protocol = crate::protocol_file::resolve(name)
            .map_err(|error| PlanError::Protocol(error.to_string()))?;
        let (truth, remedy, has): (_, _, fn(&Sample) -> bool) = match protocol.ground_truth {
            GroundTruthKind::StereoNoc => ("stereo 2015", "prep kitti", |s| s.depth_noc.is_some()),
            GroundTruthKind::StereoOcc => ("stereo 2015", "prep kitti", |s| s.depth_occ.is_some()),
            GroundTruthKind::VelodyneX => {
                ("Velodyne", "prep eigen", |s| s.depth_velodyne.is_some())
            }
            GroundTruthKind::CameraZ => ("camera-z", "prep eigen", |s| s.depth_camera.is_some()),
            GroundTruthKind::Annotated => ("KITTI depth", "prep eigen --annotated", |s| {
                s.depth_annotated.is_some()
            }),
            GroundTruthKind::Laser => ("laser", "prep make3d", |s| s.depth_laser.is_some()),
        };
        if !samples.iter().any(has) {
            return Err(PlanError::WrongTruth {
                name: name.clone(),
                truth,
                found: content,
                remedy,
            });
        }
        if protocol.grouping == Grouping::Cityscapes && !has_labels {
            return Err(PlanError::NoLabels);
        }
        match plan
            .protocols
            .iter()
            .find(|known| known.name == protocol.name)
        {
            None => plan.protocols.push(protocol),
            // The same one asked for again, perhaps in another order of suffixes.
            Some(known) if *known == protocol => {}
            Some(_) => {
                return Err(PlanError::Protocol(format!(
                    "two different protocols are called \"{}\", and their rows could not be told \
                     apart; give one of them another name",
                    protocol.name
                )));
            }
        }
    }
    Ok(plan)
}

/// Why results could not be written.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    /// A file could not be written.
    #[error(transparent)]
    Store(#[from] strat_store::Error),
    /// The rows do not make a table.
    #[error(transparent)]
    Table(#[from] TableError),
    /// The rows do not make a leaderboard.
    #[error(transparent)]
    Rows(#[from] rows::RowsError),
    /// CSV could not be formed.
    #[error(transparent)]
    Csv(#[from] strat_metrics::CsvError),
}

/// What ran, as written to `run.yaml`.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct RunRecord {
    /// The program.
    pub tool: String,
    /// Its version.
    pub tool_version: String,
    /// The command line, without the program's name.
    pub arguments: Vec<String>,
    /// The data.
    pub data: DataRecord,
    /// Tables that were asked for.
    #[serde(default)]
    pub tables: Vec<String>,
    /// The part that was measured, where it is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shard: Option<Shard>,
    /// Device asked for.
    pub device: String,
    /// Runtime and version.
    pub runtime: String,
    /// Its library, when it has one.
    pub runtime_library: Option<PathBuf>,
    /// Threads for decoding and metrics.
    pub jobs: usize,
    /// Threads within a model.
    pub threads: usize,
    /// The models.
    pub models: Vec<ModelRecord>,
    /// The protocols with their digests and full rules.
    pub protocols: Vec<ProtocolRecord>,
    /// Everything that was warned about.
    pub warnings: Vec<String>,
    /// Images that failed, over all models.
    pub failures: usize,
    /// Nothing failed.
    #[serde(default)]
    pub complete: bool,
}

/// The data of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DataRecord {
    /// The folder as given.
    pub path: PathBuf,
    /// Recorded or rendered.
    pub source: String,
    /// What the set was made of.
    pub content: Content,
    /// Digest of the split's lists, for a split of KITTI.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub split_digest: Option<String>,
    /// Digest of the prepared set.
    pub data_digest: String,
    /// Test images that the split has.
    pub test_images_expected: u64,
    /// Test images in the set.
    pub test_images_found: u64,
    /// Version of the program that prepared it.
    pub prepared_by: String,
}

/// One model of a run.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ModelRecord {
    /// Name in tables.
    pub name: String,
    /// The file; none for the median baseline.
    pub file: Option<PathBuf>,
    /// BLAKE3 of the file, or of the baseline's map.
    pub blake3: String,
    /// How it is fed and read.
    pub description: Option<crate::model::Description>,
    /// What its numbers are, where they were saved and no model ran.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub saved: Option<crate::evaluate::predictions::SavedDescription>,
    /// What its trainer says about it.
    pub metadata: Option<strat_onnx::metadata::ModelMetadata>,
    /// Number of weights.
    pub parameters: Option<u64>,
    /// Runtime and version.
    pub runtime: String,
    /// The provider that the graph's nodes were really given to.
    pub provider: String,
    /// Largest difference to the trainer's own output for the probe image.
    pub probe_max_difference: Option<f32>,
    /// Images with at least one row.
    pub images: usize,
    /// Wall-clock time of the whole prediction path, decoding and metrics included.
    pub seconds: f64,
    /// A sentence where more is to be said.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub note: Option<String>,
}

/// One protocol of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ProtocolRecord {
    /// Name.
    pub name: String,
    /// Digest of the rules.
    pub digest: String,
    /// The rules.
    pub rules: Protocol,
}

impl ProtocolRecord {
    /// Takes a protocol down.
    #[must_use]
    pub fn new(protocol: &Protocol) -> Self {
        Self {
            name: protocol.name.clone(),
            digest: protocol.digest(),
            rules: protocol.clone(),
        }
    }
}

/// What a run, or a part of one, has found.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// What ran.
    pub record: RunRecord,
    /// Rows in the order model, protocol, image, group.
    pub rows: Vec<Row>,
    /// What failed, in the order model, image.
    pub failures: Vec<Failure>,
}

impl Outcome {
    /// Writes `rows.csv`, `failures.csv` and, last, `run.yaml`.
    ///
    /// # Errors
    /// A file cannot be written.
    pub fn write(&self, out: &Path) -> Result<(), WriteError> {
        let mut bytes = Vec::new();
        rows::write(&self.rows, &mut bytes)?;
        files::write_atomic(&out.join(ROWS), &bytes)?;
        write_failures(out, &self.failures)?;
        let text = yaml::to_string(&self.record)?;
        Ok(files::write_atomic(&out.join(RECORD), text.as_bytes())?)
    }
}

/// The file of rows.
pub const ROWS: &str = "rows.csv";

/// The file of images that failed.
pub const FAILURES: &str = "failures.csv";

/// The file that says what ran.
pub const RECORD: &str = "run.yaml";

/// Brings rows into the order model, protocol, image; rows of one image under one protocol keep
/// theirs. What is in none of the lists comes last.
pub fn sort_rows(rows: &mut [Row], models: &[&str], protocols: &[&str], images: &[&str]) {
    let places = |names: &[&str]| -> HashMap<String, usize> {
        names.iter().map(|&name| name.to_owned()).zip(0..).collect()
    };
    let (models, protocols, images) = (places(models), places(protocols), places(images));
    let place = |places: &HashMap<String, usize>, name: &str| {
        places.get(name).copied().unwrap_or(usize::MAX)
    };
    rows.sort_by_key(|row| {
        (
            place(&models, &row.context.model),
            place(&protocols, &row.context.protocol),
            place(&images, &row.image),
        )
    });
}

/// How many test images there are and should be.
#[must_use]
pub fn test_count(set: &PreparedSet, samples: &[Sample]) -> Count {
    let found = samples.len() as u64;
    let expected = set
        .manifest
        .counts
        .get(&Role::Test)
        .map_or(found, |count| count.expected);
    Count {
        // A set with more images than its split would make shares above one.
        expected: expected.max(found),
        found,
    }
}

/// Writes the tables in four formats and returns them for printing.
///
/// Models that needed median scaling stand in tables of their own (`-median`), since their
/// figures are not comparable with the others'.
///
/// # Errors
/// The rows do not fit together, or a file cannot be written.
pub fn write_tables(
    out: &Path,
    tables: &[ThesisTable],
    rows: &[Row],
    coverage: &Coverage,
) -> Result<Vec<Table>, WriteError> {
    let mut written = Vec::new();
    for &id in tables {
        let any = |names: &[String]| rows.iter().any(|row| names.contains(&row.context.protocol));
        let mut scales: Vec<Scale> = Scale::ALL
            .into_iter()
            .filter(|scale| any(&id.protocols_at(*scale)))
            .collect();
        if scales.is_empty() {
            scales.push(Scale::Own);
        }
        for scale in scales {
            let protocols = id.protocols_at(scale);
            let stem = format!(
                "table_{}{}",
                id.to_string().replace('.', "_"),
                scale.suffix()
            );
            let protocols: Vec<&str> = protocols.iter().map(String::as_str).collect();
            let table = tables::build_with(id, &protocols, rows, coverage)?;
            for (extension, text) in [
                ("txt", table.text()),
                ("md", table.markdown()),
                ("tex", table.latex()),
                ("csv", table.csv()?),
            ] {
                let path = out.join(format!("{stem}.{extension}"));
                files::write_atomic(&path, text.as_bytes())?;
            }
            written.push(table);
        }
    }
    Ok(written)
}

/// Writes `leaderboard.csv`: the measured lines and the published ones of the same protocols.
///
/// # Errors
/// The rows do not fit together, or the file cannot be written.
pub fn write_leaderboard(
    out: &Path,
    rows: &[Row],
    expected_images: u64,
) -> Result<Vec<leaderboard::Entry>, WriteError> {
    let mut protocols: Vec<&str> = Vec::new();
    for row in rows {
        let name = row.context.protocol.as_str();
        if !protocols.contains(&name) {
            protocols.push(name);
        }
    }
    let mut entries = Vec::new();
    for name in &protocols {
        let bootstrap = Bootstrap::default();
        entries.extend(leaderboard::measured(
            rows,
            name,
            expected_images,
            &bootstrap,
        )?);
    }
    entries.extend(
        leaderboard::published()
            .into_iter()
            .filter(|entry| protocols.contains(&entry.protocol.as_str())),
    );
    let merged = leaderboard::merge([entries])?;
    let mut bytes = Vec::new();
    leaderboard::write(&merged, &mut bytes)?;
    files::write_atomic(&out.join("leaderboard.csv"), &bytes)?;
    Ok(merged)
}

/// Measured lines under protocols that none of the tables shows, as text; empty if there are none.
/// Distances of one model share a line, with Abs Rel alone.
#[must_use]
pub fn beside_tables(entries: &[leaderboard::Entry], tables: &[ThesisTable]) -> String {
    let mut text = String::new();
    let mut by_distance: Vec<((&str, &str), String)> = Vec::new();
    for entry in entries {
        let shown = ThesisTable::showing(&entry.protocol);
        if entry.origin != leaderboard::Origin::Measured
            || shown.is_some_and(|(table, _)| tables.contains(&table))
        {
            continue;
        }
        if let (Some(group), [Some(abs_rel), ..]) = (
            entry.group.filter(|group| group.distance_m().is_some()),
            &entry.metrics,
        ) {
            let key = (entry.method.as_str(), entry.protocol.as_str());
            let figure = format!(" {group} {abs_rel:.3}");
            match by_distance.iter_mut().find(|(known, _)| *known == key) {
                Some((_, figures)) => *figures += &figure,
                None => by_distance.push((key, figure)),
            }
            continue;
        }
        let group = entry
            .group
            .map_or(String::new(), |group| format!(", {group}"));
        let images = entry.images.unwrap_or_default();
        text += &format!(
            "{} under {}{group}, {images} of {} images:",
            entry.method,
            entry.protocol,
            entry.expected_images.unwrap_or(images)
        );
        for (metric, (mean, interval)) in Metric::ALL
            .iter()
            .zip(entry.metrics.iter().zip(&entry.intervals))
        {
            let Some(mean) = mean else { continue };
            text += &format!(" {} {mean:.3}", metric.heading());
            if let Some(interval) = interval {
                text += &format!(" ({:.3} to {:.3})", interval.low, interval.high);
            }
        }
        text.push('\n');
    }
    for ((method, protocol), figures) in by_distance {
        text += &format!("{method} under {protocol}, Abs Rel by true depth:{figures}\n");
    }
    text
}

/// Writes `failures.csv`, or removes that of an earlier run when nothing failed.
fn write_failures(out: &Path, failures: &[Failure]) -> Result<(), WriteError> {
    if failures.is_empty() {
        return Ok(files::remove(&out.join(FAILURES))?);
    }
    let mut csv = csv::Writer::from_writer(Vec::new());
    let as_error = strat_metrics::CsvError::from;
    csv.write_record(["model", "image", "reason"])
        .map_err(as_error)?;
    for failure in failures {
        csv.write_record([&failure.model, &failure.image, &failure.reason])
            .map_err(as_error)?;
    }
    let bytes = csv.into_inner().unwrap_or_default();
    Ok(files::write_atomic(&out.join(FAILURES), &bytes)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use strat_store::set::FileRef;

    fn sample(content: Content, labels: bool) -> Sample {
        let file = FileRef {
            path: "x".to_owned(),
            blake3: String::new(),
        };
        let truth = |wanted| (content == wanted).then(|| file.clone());
        Sample {
            depth_noc: truth(Content::Kitti),
            depth_occ: truth(Content::Kitti),
            depth_velodyne: truth(Content::Eigen),
            semantic: labels.then(|| file.clone()),
            ..Sample::new("kitti2015/000000", (4, 4), 1.0, 1.0, file.clone())
        }
    }

    const COUNT: Count = Count {
        expected: 200,
        found: 1,
    };

    fn try_plan(choice: TableChoice, content: Content, labels: bool) -> Result<Plan, PlanError> {
        plan(choice, &[], content, &[sample(content, labels)], COUNT)
    }

    fn names(plan: &Plan) -> Vec<&str> {
        plan.protocols.iter().map(|p| p.name.as_str()).collect()
    }

    #[test]
    fn all_means_what_the_set_offers() {
        let with = try_plan(TableChoice::All, Content::Kitti, true).unwrap();
        assert_eq!(names(&with), ["kitti2015", "semantic"]);
        let without = try_plan(TableChoice::All, Content::Kitti, false).unwrap();
        assert_eq!(names(&without), ["kitti2015"]);
        assert!(without.left_out[0].contains("--semantics"));
        let eigen = try_plan(TableChoice::All, Content::Eigen, false).unwrap();
        assert_eq!(names(&eigen), ["eigen-80", "eigen-50"]);
        assert_eq!(eigen.tables, [ThesisTable::Table33]);
    }

    #[test]
    fn a_table_of_the_other_split_is_refused() {
        let error = try_plan(TableChoice::Table31, Content::Eigen, false).unwrap_err();
        let text = error.to_string();
        assert!(
            text.contains("table 3.1 is about the kitti split"),
            "{text}"
        );
        assert!(text.contains("`prep kitti`"), "{text}");
        assert!(text.contains("table 3.3"), "{text}");
        assert!(try_plan(TableChoice::Table33, Content::Kitti, true).is_err());
        assert_eq!(
            try_plan(TableChoice::Table32, Content::Kitti, false),
            Err(PlanError::NoLabels)
        );
    }

    #[test]
    fn protocols_by_name_are_added_once() {
        let asked = ["kitti2015-occ", "kitti2015"].map(String::from);
        let plan = plan(
            TableChoice::Table31,
            &asked,
            Content::Kitti,
            &[sample(Content::Kitti, false)],
            COUNT,
        )
        .unwrap();
        assert_eq!(names(&plan), ["kitti2015", "kitti2015-occ"]);
        let wrong = super::plan(
            TableChoice::Table31,
            &["eigen-80".to_owned()],
            Content::Kitti,
            &[sample(Content::Kitti, false)],
            COUNT,
        );
        assert!(wrong.unwrap_err().to_string().contains("Velodyne"));
        let none = super::plan(TableChoice::All, &[], Content::Kitti, &[], COUNT);
        assert!(none.unwrap_err().to_string().contains("200 expected"));
    }
}
