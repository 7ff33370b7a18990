//! The LaTeX tables as pdflatex sets them: in an article of one column and in a paper of two.

use std::{fs, process::Command};

use strat_metrics::{
    FurtherMetrics, Group, ImageScore, Metrics, Row, RowContext, protocol,
    tables::{self, Coverage, REFERENCES, Source, Table, ThesisTable},
};
use strat_needs::Need;

/// Names as users give them, one of them long.
const MODELS: [&str; 4] = [
    "StrAT",
    "a_b & 5 %",
    "Median depth (constant)",
    "dpt_swin2_tiny_256_finetuned",
];

fn table(id: ThesisTable) -> Table {
    let mut rows = Vec::new();
    for name in id.protocols() {
        let rules = protocol(name).unwrap();
        for (number, model) in MODELS.iter().enumerate() {
            let context = RowContext {
                model: (*model).to_owned(),
                model_hash: model.to_string(),
                protocol: (*name).to_owned(),
                protocol_digest: rules.digest(),
                data_digest: "digest".to_owned(),
                ..RowContext::default()
            };
            let groups: Vec<Option<Group>> = match id {
                ThesisTable::Table32 => Group::SEMANTIC.map(Some).to_vec(),
                _ => vec![None],
            };
            for image in 0..4 {
                for group in &groups {
                    let value = 0.1 + 0.01 * f64::from(image) + 0.02 * number as f64;
                    let score = ImageScore {
                        group: *group,
                        metrics: Metrics {
                            abs_rel: value,
                            sq_rel: 10.0 * value,
                            rmse: 150.0 * value,
                            rmse_log: value,
                            a1: 1.0 - value,
                            a2: 1.0 - value / 2.0,
                            a3: 1.0 - value / 4.0,
                        },
                        further: (id == ThesisTable::Eigen652).then_some(FurtherMetrics {
                            silog: 80.0 * value,
                            log10: value,
                            irmse: 90.0 * value,
                            mae: 20.0 * value,
                            sq_rel_2: value,
                        }),
                        d1_all: (id == ThesisTable::Table31).then_some(100.0 * value),
                        sum_squared_error: 100.0,
                        pixels: 100,
                        floored_pixels: 0,
                        fit: None,
                    };
                    let name = format!("2011_09_26_drive_{image:04}/{image:010}");
                    rows.push(Row::new(&context, name, score));
                }
            }
        }
    }
    let coverage = Coverage {
        expected_images: 4,
        source: Source::Kitti,
    };
    tables::build(id, &rows, &coverage).unwrap()
}

#[test]
fn tables_fit_the_page() {
    let text: String = ThesisTable::ALL
        .iter()
        .map(|id| table(*id).latex())
        .collect();
    // With D1-all it is still one block of numbers.
    let tabulars = table(ThesisTable::Table31).latex();
    assert_eq!(
        tabulars.matches("\\begin{tabular}").count(),
        1,
        "{tabulars}"
    );
    for part in [
        "\\cite{godard2017}",
        "\\second{",
        "\\providecommand{\\best}",
    ] {
        assert!(text.contains(part), "no {part} in {text}");
    }
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("table_references.bib"), REFERENCES).unwrap();
    fs::write(folder.path().join("tables.tex"), text).unwrap();
    for class in [
        "\\documentclass{article}",
        "\\documentclass[twocolumn]{article}",
    ] {
        let document = format!(
            "{class}\n\\usepackage{{booktabs}}\n\\usepackage{{xcolor}}\n\\begin{{document}}\n\\input{{tables}}\n\
             \\end{{document}}\n"
        );
        fs::write(folder.path().join("paper.tex"), document).unwrap();
        let ran = Command::new("pdflatex")
            .args(["-interaction=nonstopmode", "-halt-on-error", "paper.tex"])
            .current_dir(folder.path())
            .output();
        let Ok(ran) = ran else {
            return Need::Latex.is_lacking("no pdflatex in the path");
        };
        let said = String::from_utf8_lossy(&ran.stdout).into_owned();
        if said.contains("booktabs.sty' not found") || said.contains("xcolor.sty' not found") {
            return Need::Latex.is_lacking("booktabs or xcolor is not installed");
        }
        assert!(ran.status.success(), "{said}");
        let overfull: Vec<&str> = said
            .lines()
            .filter(|line| line.contains("Overfull"))
            .collect();
        assert!(overfull.is_empty(), "{class}: {overfull:?}");
    }
}
