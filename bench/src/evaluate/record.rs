//! What a run leaves behind: rows, failures, and `run.yaml`, which says what ran.

use std::{
    collections::HashMap,
    path::{Path, PathBuf},
};

use serde::{Deserialize, Serialize};
use strat_metrics::{Protocol, Row, RowContext};
use strat_store::{
    set::{Content, Count, Manifest},
    shard::Shard,
};

use super::{
    agreed::Agreed, agreement::Agreement, identity::Identity, predictions::SavedDescription,
};
use crate::model::{Description, ValueEncoding};

/// The version that rows and records name.
pub const TOOL_VERSION: &str = env!("CARGO_PKG_VERSION");

/// The file of rows.
pub const ROWS: &str = "rows.csv";

/// The file of images that failed.
pub const FAILURES: &str = "failures.csv";

/// The folder of comparison pictures.
pub const PICTURES: &str = "pictures";

/// The file of leaderboard lines.
pub const LEADERBOARD: &str = "leaderboard.csv";

/// The file that says what ran.
pub const RECORD: &str = "run.yaml";

/// An image without a row, or with fewer rows than protocols.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Failure {
    /// Name of the model.
    pub model: String,
    /// Image id.
    pub image: String,
    /// A sentence.
    pub reason: String,
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

impl DataRecord {
    /// Takes down the set in the folder `path`, with the count of its test images.
    #[must_use]
    pub fn new(path: &Path, manifest: &Manifest, count: Count) -> Self {
        Self {
            path: path.to_path_buf(),
            source: manifest.source.clone(),
            content: manifest.content,
            split_digest: manifest.split_digest.clone(),
            data_digest: manifest.data_digest.clone(),
            test_images_expected: count.expected,
            test_images_found: count.found,
            prepared_by: manifest.tool_version.clone(),
        }
    }
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
    /// All that identifies its rows: the file, the description beside it, whose map is whose.
    #[serde(default, skip_serializing_if = "Identity::is_empty")]
    pub identity: Identity,
    /// How it is fed and read.
    pub description: Option<Description>,
    /// What its numbers are, where they were saved and no model ran.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub saved: Option<SavedDescription>,
    /// What its trainer says about it.
    pub metadata: Option<strat_onnx::metadata::ModelMetadata>,
    /// Number of weights.
    pub parameters: Option<u64>,
    /// Runtime and version.
    pub runtime: String,
    /// The provider that the graph's nodes were really given to.
    pub provider: String,
    /// Threads within an operation of it; none where no model ran.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub threads: Option<usize>,
    /// Largest difference to the trainer's own output for the probe image.
    pub probe_max_difference: Option<f32>,
    /// How its depth lies beside the truth as a whole, over the images measured here.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub agreement: Option<Agreement>,
    /// In the record of a part: which of its warnings, from the first to before the second, follow from the
    /// model's rows and maps. Those of the whole are others.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub findings: Option<[usize; 2]>,
    /// Images with at least one row.
    pub images: usize,
    /// Wall-clock time of the whole prediction path, decoding and metrics included.
    pub seconds: f64,
    /// A sentence where more is to be said.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub note: Option<String>,
}

impl ModelRecord {
    /// What is measured without a model: no file, no network, no runtime.
    #[must_use]
    pub fn new(name: &str, blake3: String) -> Self {
        Self {
            name: name.to_owned(),
            file: None,
            identity: Identity::of_bytes(&blake3),
            blake3,
            description: None,
            saved: None,
            metadata: None,
            parameters: None,
            runtime: "none".to_owned(),
            provider: "none".to_owned(),
            threads: None,
            probe_max_difference: None,
            agreement: None,
            findings: None,
            images: 0,
            seconds: 0.0,
            note: None,
        }
    }
}

impl ModelRecord {
    /// All that the numbers of its rows depend on, protocol and data aside.
    #[must_use]
    pub fn facts(&self) -> Identity {
        // Records of earlier versions know the file only.
        let mut facts = if self.identity.is_empty() {
            Identity::of_bytes(&self.blake3)
        } else {
            self.identity.clone()
        };
        facts.add("runtime", &self.runtime);
        facts.add("provider", &self.provider);
        if let Some(threads) = self.threads {
            // Sums are divided among threads, and a sum depends on its order.
            facts.add("threads within the model", &threads.to_string());
        }
        facts
    }
}

impl ModelRecord {
    /// What its numbers are; none of a baseline.
    #[must_use]
    pub fn encoding(&self) -> Option<ValueEncoding> {
        let description = self.description.as_ref();
        let saved = self.saved.as_ref();
        description
            .map(|description| description.output.encoding())
            .or_else(|| saved.map(SavedDescription::encoding))
    }

    /// What its rows under a protocol share.
    #[must_use]
    pub fn context(&self, protocol: &Protocol, manifest: &Manifest) -> RowContext {
        let metadata = self.metadata.as_ref();
        RowContext {
            model: self.name.clone(),
            model_hash: self.identity.digest(),
            variant: metadata.and_then(|metadata| metadata.variant.clone()),
            protocol: protocol.name.clone(),
            protocol_digest: protocol.digest(),
            data_digest: manifest.data_digest.clone(),
            split: manifest.content.to_string(),
            runtime: self.runtime.clone(),
            provider: self.provider.clone(),
            tool_version: TOOL_VERSION.to_owned(),
        }
    }
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
    /// Of a part of a divided run, how its images agree with the truth, in the order model, image.
    pub agreed: Vec<Agreed>,
}

/// Brings rows into the order model, protocol, image; rows of one image under one protocol keep
/// theirs. What is in none of the lists comes last.
pub fn sort_rows(rows: &mut [Row], models: &[&str], protocols: &[&str], images: &[&str]) {
    let positions = |names: &[&str]| -> HashMap<String, usize> {
        names.iter().map(|&name| name.to_owned()).zip(0..).collect()
    };
    let (models, protocols, images) = (positions(models), positions(protocols), positions(images));
    let position = |positions: &HashMap<String, usize>, name: &str| {
        positions.get(name).copied().unwrap_or(usize::MAX)
    };
    rows.sort_by_key(|row| {
        (
            position(&models, &row.context.model),
            position(&protocols, &row.context.protocol),
            position(&images, &row.image),
        )
    });
}

/// File name for something called `name`.
#[must_use]
pub fn slug(name: &str) -> String {
    let slug: String = name
        .chars()
        .map(|c| {
            if c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.') {
                c
            } else {
                '_'
            }
        })
        .collect();
    // A name of dots would be a folder.
    if slug.chars().all(|c| c == '.') {
        "_".to_owned()
    } else {
        slug
    }
}
