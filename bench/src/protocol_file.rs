//! Protocols of the user's own, read from YAML.
//!
//! A file names a built-in protocol as `base` and what is to differ, or all fields of a
//! [`Protocol`]:
//!
//! ```yaml
//! name: eigen-60
//! base: eigen-80
//! max_depth_m: 60.0
//! ```
//!
//! The digest of such a protocol is made of its fields as that of any other, so rows of two
//! definitions under one name do not mix. Not here: the protocols by name, which are
//! [`strat_metrics::protocols`].

use std::path::{Path, PathBuf};

use serde::Deserialize;
use strat_metrics::{
    Alignment, BenchmarkCrop, Camera, Crop, D1Rule, GroundTruthKind, Grouping, InfiniteDepth,
    LogBase, PostProcessing, Protocol, Resize, protocol,
};
use strat_store::yaml;

/// Why there is no such protocol.
#[derive(Debug, thiserror::Error)]
pub enum ProtocolError {
    /// No such name.
    #[error(
        "unknown protocol \"{0}\"; `bench protocols` lists them, and a file of your own must \
         end in .yaml"
    )]
    Unknown(String),
    /// The file cannot be read, or has a key or value that no protocol has.
    #[error(transparent)]
    File(#[from] strat_store::Error),
    /// Fields are missing, contradict each other or collide with a built-in protocol.
    #[error("{path}: {problem}")]
    Content {
        /// The file.
        path: PathBuf,
        /// A sentence.
        problem: String,
    },
}

/// D1-all with a word for leaving it out, since a key that is not there leaves the base's.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum D1 {
    None,
    Inclusive,
    Strict,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Text {
    name: String,
    base: Option<String>,
    version: Option<u32>,
    ground_truth: Option<GroundTruthKind>,
    camera: Option<Camera>,
    crop: Option<Crop>,
    min_depth_m: Option<f64>,
    max_depth_m: Option<f64>,
    mask_ground_truth: Option<bool>,
    strict_comparisons: Option<bool>,
    disparity_floor_fraction: Option<f64>,
    infinite_depth: Option<InfiniteDepth>,
    #[serde(alias = "median_scaling")]
    alignment: Option<Alignment>,
    post_processing: Option<PostProcessing>,
    d1_rule: Option<D1>,
    grouping: Option<Grouping>,
    resize: Option<Resize>,
    log_base: Option<LogBase>,
    benchmark_crop: Option<BenchmarkCrop>,
}

/// The protocol of that name, or of that file where the name ends in `.yaml` or `.yml`.
///
/// # Errors
/// No such name, or a file that is no protocol.
pub fn resolve(name: &str) -> Result<Protocol, ProtocolError> {
    if name.ends_with(".yaml") || name.ends_with(".yml") {
        load(Path::new(name))
    } else {
        protocol(name).ok_or_else(|| ProtocolError::Unknown(name.to_owned()))
    }
}

/// Reads a protocol of the user's own.
///
/// # Errors
/// Unknown keys (with their line), missing fields, contradictions, and names of built-in
/// protocols.
pub fn load(path: &Path) -> Result<Protocol, ProtocolError> {
    let text: Text = yaml::load(path)?;
    let problem = |problem: String| ProtocolError::Content {
        path: path.to_owned(),
        problem,
    };
    if protocol(&text.name).is_some() {
        return Err(problem(format!(
            "\"{}\" is the name of a built-in protocol, whose rows would be taken for these; \
             choose another name",
            text.name
        )));
    }
    let base = match &text.base {
        None => None,
        Some(base) => Some(protocol(base).ok_or_else(|| {
            problem(format!(
                "unknown protocol \"{base}\" to start from; `bench protocols` lists them"
            ))
        })?),
    };
    macro_rules! field {
        ($name:ident) => {
            text.$name
                .or(base.as_ref().map(|base| base.$name))
                .ok_or_else(|| {
                    problem(format!(
                        "without `base:` every field is needed, and `{}` is missing",
                        stringify!($name)
                    ))
                })?
        };
    }
    let made = Protocol {
        version: text.version.unwrap_or(1),
        ground_truth: field!(ground_truth),
        camera: field!(camera),
        crop: field!(crop),
        min_depth_m: field!(min_depth_m),
        max_depth_m: field!(max_depth_m),
        mask_ground_truth: field!(mask_ground_truth),
        strict_comparisons: field!(strict_comparisons),
        disparity_floor_fraction: field!(disparity_floor_fraction),
        infinite_depth: field!(infinite_depth),
        alignment: (text.alignment)
            .or(base.as_ref().map(|base| base.alignment))
            .unwrap_or_default(),
        post_processing: field!(post_processing),
        d1_rule: match text.d1_rule {
            Some(D1::None) => None,
            Some(D1::Inclusive) => Some(D1Rule::Inclusive),
            Some(D1::Strict) => Some(D1Rule::Strict),
            None => base.as_ref().and_then(|base| base.d1_rule),
        },
        grouping: field!(grouping),
        resize: (text.resize)
            .or(base.as_ref().map(|base| base.resize))
            .unwrap_or_default(),
        log_base: (text.log_base)
            .or(base.as_ref().map(|base| base.log_base))
            .unwrap_or_default(),
        benchmark_crop: (text.benchmark_crop)
            .or(base.as_ref().map(|base| base.benchmark_crop))
            .unwrap_or_default(),
        name: text.name,
    };
    made.check().map_err(|reason| {
        problem(format!(
            "protocol {} cannot be followed: {reason}",
            made.name
        ))
    })?;
    Ok(made)
}

/// What differs between two protocols, for people.
#[must_use]
pub fn difference(a: &Protocol, b: &Protocol) -> String {
    let differences = a.difference(b);
    if differences.is_empty() {
        return format!("{} and {} have the same rules.\n", a.name, b.name);
    }
    let width = a.name.chars().count().max(b.name.chars().count());
    let mut text = String::new();
    for (mine, theirs) in differences {
        for (name, line) in [(&a.name, &mine), (&b.name, &theirs)] {
            let line = if line.is_empty() {
                "(nothing of the kind)"
            } else {
                line
            };
            text += &format!("{name:<width$}  {line}\n");
        }
        text.push('\n');
    }
    text.pop();
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn loaded(text: &str) -> Result<Protocol, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("mine.yaml");
        std::fs::write(&path, text).unwrap();
        resolve(path.to_str().unwrap()).map_err(|error| error.to_string())
    }

    #[test]
    fn a_base_and_what_differs() {
        let made = loaded("name: eigen-60\nbase: eigen-80\nmax_depth_m: 60\n").unwrap();
        let base = protocol("eigen-80").unwrap();
        let text = difference(&base, &made);
        assert!(
            text.contains("eigen-60  Clip: predictions to 0.001 m .. 60 m."),
            "{text}"
        );
        assert_eq!(
            made,
            Protocol {
                name: "eigen-60".to_owned(),
                max_depth_m: 60.0,
                ..base
            }
        );
        assert_eq!(
            loaded("name: k\nbase: kitti2015\nd1_rule: none\n")
                .unwrap()
                .d1_rule,
            None
        );
    }

    #[test]
    fn all_fields_as_a_run_records_them() {
        for known in strat_metrics::protocols() {
            let renamed = Protocol {
                name: format!("my-{}", known.name),
                ..known
            };
            let text = yaml::to_string(&renamed).unwrap();
            assert_eq!(loaded(&text).unwrap(), renamed, "{text}");
        }
    }

    #[test]
    fn refusals_say_where_and_why() {
        for (text, words) in [
            ("name: a\nbase: eigen-80\ncropp: none\n", "line 3"),
            ("name: a\nbase: eigen-80\ncropp: none\n", "cropp"),
            ("name: eigen-50\nbase: eigen-80\n", "built-in"),
            ("name: eigen-80-pp\nbase: eigen-80\n", "built-in"),
            ("name: a\nbase: eigen-81\n", "unknown protocol \"eigen-81\""),
            ("name: a\ncrop: none\n", "`ground_truth` is missing"),
            (
                "name: a\nbase: eigen-80\nmin_depth_m: 90\n",
                "0 < min < max",
            ),
            (
                "name: a\nbase: eigen-80\nmin_depth_m: .nan\n",
                "0 < min < max",
            ),
            ("name: ../a\nbase: eigen-80\n", "letters"),
        ] {
            let error = loaded(text).unwrap_err();
            assert!(
                error.contains(words) && error.contains("mine.yaml"),
                "{text}: {error}"
            );
        }
        assert!(
            resolve("eigen-81")
                .unwrap_err()
                .to_string()
                .contains("bench protocols")
        );
    }
}
