//! Under which protocols predictions of a meaning are measured: which alignments fit them
//! (PROTOCOL 10.1).

use strat_metrics::{Alignment, Protocol, ProtocolName, Suffix, protocol};
use strat_onnx::metadata::OutputMeaning;

use super::predictions::SavedDescription;
use crate::view::View;

/// The alignments that fit a meaning.
#[must_use]
pub fn fitting(meaning: OutputMeaning) -> &'static [Alignment] {
    match meaning {
        OutputMeaning::InverseDepth => &[
            Alignment::Median,
            Alignment::ScaleDisparity,
            Alignment::AffineDisparity,
        ],
        OutputMeaning::Depth => &[
            Alignment::Median,
            Alignment::ScaleDepth,
            Alignment::AffineDepth,
        ],
        OutputMeaning::DisparityFraction
        | OutputMeaning::DisparityPx
        | OutputMeaning::InverseDepthPerM
        | OutputMeaning::DepthM => &Alignment::ALL,
    }
}

/// The alignment that papers use for models of this meaning.
#[must_use]
pub fn usual(meaning: OutputMeaning) -> Alignment {
    match meaning {
        OutputMeaning::InverseDepth => Alignment::AffineDisparity,
        OutputMeaning::Depth => Alignment::AffineDepth,
        _ => Alignment::None,
    }
}

/// What becomes of the protocols of a run for predictions of one kind.
#[derive(Debug, Default, PartialEq)]
pub struct Fitted {
    /// Those that are measured.
    pub protocols: Vec<Protocol>,
    /// Sentences about protocols that became others.
    pub warnings: Vec<String>,
    /// Sentences about what else a reader of the rows should know.
    pub notes: Vec<String>,
    /// Sentences about protocols that do not fit.
    pub refused: Vec<String>,
}

/// Chooses among the protocols of a run for a model of a meaning. Of `sections`, by name, a table
/// shows each model only in the one that is usual for its meaning. Protocols without an alignment are
/// scaled by medians where depth has no scale.
#[must_use]
pub fn of_model(
    name: &str,
    meaning: OutputMeaning,
    protocols: &[Protocol],
    sections: &[String],
) -> Fitted {
    let mut fitted = Fitted::default();
    let mut scaled_by_medians = false;
    for protocol in protocols {
        let alignment = protocol.alignment;
        if sections.contains(&protocol.name) {
            if alignment == usual(meaning) {
                fitted.protocols.push(protocol.clone());
            }
            continue;
        }
        let protocol = if fitting(meaning).contains(&alignment) {
            protocol.clone()
        } else if alignment == Alignment::None {
            scaled_by_medians = true;
            protocol.clone().with(Suffix::Align(Alignment::Median))
        } else {
            fitted.refused.push(refusal(protocol, meaning, name));
            continue;
        };
        // What was asked for with the suffix as well is one protocol.
        if !fitted.protocols.contains(&protocol) {
            fitted.protocols.push(protocol);
        }
    }
    if scaled_by_medians {
        let what = match meaning {
            OutputMeaning::Depth => "depth",
            _ => "inverse depth",
        };
        fitted.warnings.push(format!(
            "model {name} gives {what} of unknown scale: its predictions are scaled by the \
             median of the ground truth, and its rows stand in tables of their own; where a shift is \
             unknown too, `{}` after a protocol's name fits both",
            Suffix::Align(usual(meaning)).as_str()
        ));
    }
    fitted
}

/// The same for maps that are handed over: what they show of their images decides as well.
#[must_use]
pub fn of_maps(
    name: &str,
    description: &SavedDescription,
    protocols: &[Protocol],
    sections: &[String],
) -> Fitted {
    let mut fitted = of_model(name, description.meaning_taken(), protocols, sections);
    let crop = description.crop;
    let all = std::mem::take(&mut fitted.protocols);
    for protocol in all {
        match (crop, View::under(&protocol)) {
            (View::Whole, View::KittiBenchmark) => fitted.notes.push(format!(
                "predictions {name} show whole images; under {} their part within KITTI's benchmark \
                 crop is scored, whatever the model was shown",
                protocol.name
            )),
            // A table's section that is not for them.
            (View::KittiBenchmark, View::Whole) if sections.contains(&protocol.name) => continue,
            (View::KittiBenchmark, View::Whole) => {
                fitted.refused.push(format!(
                    "predictions {name} show KITTI's benchmark crop, and {} is about whole images; \
                     measure them under `eigen-kb-garg`, or under a protocol of your own with \
                     `benchmark_crop: image`",
                    protocol.name
                ));
                continue;
            }
            (View::Whole, View::Whole) | (View::KittiBenchmark, View::KittiBenchmark) => {}
        }
        fitted.protocols.push(protocol);
    }
    fitted
}

fn refusal(unfit: &Protocol, meaning: OutputMeaning, name: &str) -> String {
    let words: Vec<String> = fitting(meaning).iter().map(ToString::to_string).collect();
    let usual = usual(meaning);
    let base = ProtocolName::parse(&unfit.name).without(Suffix::Align(unfit.alignment));
    let names = [
        base.with(Suffix::Align(usual)).to_string(),
        format!("eigen-{usual}"),
    ];
    let example = names.iter().find(|name| protocol(name).is_some());
    format!(
        "model {name} gives `{meaning}`, which {} cannot align (`{}`); what fits are the alignments \
         {}{}",
        unfit.name,
        unfit.alignment,
        words.join(", "),
        example.map_or_else(String::new, |example| format!(", such as `{example}`"))
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn named(names: &[&str]) -> Vec<Protocol> {
        names.iter().map(|name| protocol(name).unwrap()).collect()
    }

    fn names(fitted: &Fitted) -> Vec<&str> {
        fitted.protocols.iter().map(|p| p.name.as_str()).collect()
    }

    #[test]
    fn what_fits_is_measured_and_the_rest_is_refused_or_scaled() {
        let all = named(&[
            "eigen-80",
            "eigen-80-median",
            "eigen-80-affine-disparity",
            "eigen-50-scale-depth",
        ]);
        let inverse = of_model("m", OutputMeaning::InverseDepth, &all, &[]);
        assert_eq!(
            names(&inverse),
            ["eigen-80-median", "eigen-80-affine-disparity"]
        );
        assert!(inverse.warnings[0].contains("`-affine-disparity`"));
        assert_eq!(
            inverse.refused,
            [
                "model m gives `inverse_depth`, which eigen-50-scale-depth cannot align \
              (`scale-depth`); what fits are the alignments median, scale-disparity, \
              affine-disparity, such as `eigen-50-affine-disparity`"
            ]
        );
        let depth = of_model("m", OutputMeaning::Depth, &all[1..], &[]);
        assert_eq!(names(&depth), ["eigen-80-median", "eigen-50-scale-depth"]);
        assert!(depth.warnings.is_empty() && depth.refused.len() == 1);
        let metric = of_model("m", OutputMeaning::DepthM, &all, &[]);
        assert_eq!((metric.protocols, metric.refused.len()), (all, 0));
        let affine = named(&["eigen-affine-depth"]);
        let other = of_model("m", OutputMeaning::InverseDepth, &affine, &[]);
        assert!(
            other.refused[0].ends_with("such as `eigen-affine-disparity`"),
            "{other:?}"
        );
    }

    /// Each model stands in one kind of section of a table that holds several.
    #[test]
    fn sections_take_what_is_usual() {
        let table = strat_metrics::tables::ThesisTable::Eigen652.protocols();
        let all = named(table);
        let sections: Vec<String> = table.iter().map(|&name| name.to_owned()).collect();
        for (meaning, expected) in [
            (
                OutputMeaning::DepthM,
                &["eigen-improved-garg", "eigen-kb-garg"][..],
            ),
            (OutputMeaning::InverseDepth, &["eigen-affine-disparity"]),
            (OutputMeaning::Depth, &["eigen-affine-depth"]),
        ] {
            let fitted = of_model("m", meaning, &all, &sections);
            assert_eq!(names(&fitted), expected, "{meaning}");
            assert!(fitted.refused.is_empty() && fitted.warnings.is_empty());
        }
        // Asked for by name, a metric model is aligned like any other.
        let asked = of_model("m", OutputMeaning::DepthM, &all, &sections[..3]);
        assert!(names(&asked).contains(&"eigen-affine-depth"));
    }

    /// A map of the crop has no place under protocols of whole images; one of the whole image has the
    /// crop's pixels too.
    #[test]
    fn what_maps_show_decides_as_well() {
        let all = named(&["eigen-improved-garg", "eigen-kb-garg"]);
        let mut description = SavedDescription::plain(OutputMeaning::DepthM);
        let whole = of_maps("m", &description, &all, &[]);
        assert_eq!((whole.protocols.len(), whole.notes.len()), (2, 1));
        description.crop = View::KittiBenchmark;
        let cut = of_maps("m", &description, &all, &[]);
        assert_eq!((names(&cut), cut.refused.len()), (vec!["eigen-kb-garg"], 1));
        let sections = ["eigen-improved-garg", "eigen-kb-garg"].map(str::to_owned);
        let section = of_maps("m", &description, &all, &sections);
        assert_eq!(
            (names(&section), section.refused.len()),
            (vec!["eigen-kb-garg"], 0)
        );
    }
}
