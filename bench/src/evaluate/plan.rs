//! Which tables a prepared set can fill, and under which protocols it is measured.

use strat_metrics::{GroundTruthKind, Grouping, PostProcessing, Protocol, tables::ThesisTable};
use strat_splits::Role;
use strat_store::set::{Content, Count, PreparedSet, Sample};

/// What `--table` asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TableChoice {
    /// KITTI split: the seven metrics.
    Table31,
    /// KITTI split: errors by semantic group.
    Table32,
    /// Eigen split: the seven metrics with caps of 80 m and 50 m.
    Table33,
    /// Make3D: the figures beside the pictures of figure 3.6.
    Make3d,
    /// Eigen split with improved ground truth: models with and without a scale.
    Eigen652,
    /// The tables of the thesis that the prepared set offers.
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
    /// Names of protocols that stand here only as sections of a table, which shows each model where it
    /// fits.
    pub sections: Vec<String>,
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
        TableChoice::Eigen652 => Some(ThesisTable::Eigen652),
        TableChoice::All => None,
    };
    let mut plan = Plan {
        tables: Vec::new(),
        protocols: Vec::new(),
        sections: Vec::new(),
        left_out: Vec::new(),
    };
    match wanted {
        // Not one of the thesis', so only on request.
        Some(table @ ThesisTable::Eigen652) if content == Content::Eigen => plan.tables.push(table),
        Some(table) if !own.contains(&table) => {
            return Err(match own.first() {
                Some(&instead) => PlanError::WrongSplit {
                    table,
                    needed: match table {
                        ThesisTable::Table31 | ThesisTable::Table32 => Content::Kitti,
                        ThesisTable::Table33 | ThesisTable::Eigen652 => Content::Eigen,
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
        .map(str::to_owned);
    let of_tables: Vec<String> = of_tables.collect();
    let canonical = |name: &String| strat_metrics::ProtocolName::parse(name).to_string();
    let asked: Vec<String> = extra_protocols.iter().map(canonical).collect();
    if plan.tables.contains(&ThesisTable::Eigen652) {
        let sections = of_tables.iter().filter(|name| !asked.contains(name));
        plan.sections = sections.cloned().collect();
    }
    let names = [&of_tables, extra_protocols].concat();
    plan.protocols = protocols_named(&names, content, samples)?;
    Ok(plan)
}

/// The tables that show figures under any of these protocols, in thesis order.
pub fn tables_showing<'a>(protocols: impl IntoIterator<Item = &'a str>) -> Vec<ThesisTable> {
    let shown = protocols.into_iter().filter_map(ThesisTable::showing);
    let shown: Vec<ThesisTable> = shown.map(|(table, _)| table).collect();
    let mut tables = ThesisTable::ALL.to_vec();
    tables.retain(|table| shown.contains(table));
    tables
}

/// What to say where [`tables_showing`] finds none.
#[must_use]
pub fn no_table_shows(protocols: &[String]) -> String {
    format!(
        "no table of the thesis is about {}; the tables are made of rows under kitti2015, semantic, \
         eigen-80, eigen-50, make3d-c1 and the protocols of table eigen-652",
        protocols.join(", ")
    )
}

/// The protocols of these names or files, each once, all of which the set can serve.
///
/// # Errors
/// There is no such protocol, two differ under one name, or the set lacks what one needs.
pub fn protocols_named(
    names: &[String],
    content: Content,
    samples: &[Sample],
) -> Result<Vec<Protocol>, PlanError> {
    let mut protocols: Vec<Protocol> = Vec::new();
    for name in names {
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
        if protocol.grouping == Grouping::Cityscapes
            && !samples.iter().any(|sample| sample.semantic.is_some())
        {
            return Err(PlanError::NoLabels);
        }
        match protocols.iter().find(|known| known.name == protocol.name) {
            None => protocols.push(protocol),
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
    Ok(protocols)
}

/// Why predictions that are handed over, and not made here, cannot be measured under a protocol.
#[must_use]
pub fn no_mirrored_images(name: &str, protocol: &Protocol) -> Option<String> {
    (protocol.post_processing == PostProcessing::Flip).then(|| {
        format!(
            "predictions {name}: {} needs predictions of mirrored images, which saved ones do not \
             have; save predictions that are post-processed and evaluate them under the protocol \
             without",
            protocol.name
        )
    })
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

    /// The table of newer models is measured on request; what is asked for by name as well is
    /// measured for every model that it fits.
    #[test]
    fn newer_models_have_a_table_on_request() {
        let mut improved = sample(Content::Eigen, false);
        improved
            .depth_annotated
            .clone_from(&improved.depth_velodyne);
        let asked = ["eigen-affine-depth".to_owned()];
        let samples = [improved];
        let made = plan(
            TableChoice::Eigen652,
            &asked,
            Content::Eigen,
            &samples,
            COUNT,
        )
        .unwrap();
        assert_eq!(names(&made), ThesisTable::Eigen652.protocols());
        assert_eq!(made.sections, &ThesisTable::Eigen652.protocols()[..3]);
        let all = plan(TableChoice::All, &[], Content::Eigen, &samples, COUNT).unwrap();
        assert_eq!(
            (names(&all), all.sections.len()),
            (vec!["eigen-80", "eigen-50"], 0)
        );
        let error = try_plan(TableChoice::Eigen652, Content::Eigen, false).unwrap_err();
        assert!(error.to_string().contains("--annotated"), "{error}");
        let error = try_plan(TableChoice::Eigen652, Content::Kitti, false).unwrap_err();
        assert!(error.to_string().contains("eigen split"), "{error}");
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
