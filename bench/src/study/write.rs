//! The files of a study's answer: `answer.txt`, `variants.csv`, `differences.csv`, the ablation in the
//! shape of Tables 3.1 and 3.3, and curves.
//!
//! All but the curves is a pure function of rows. Not here: pictures of what models make of images.

use std::path::Path;

use strat_metrics::{
    Metric, Row,
    study::Study,
    tables::{self, Coverage, Table, ThesisTable},
};
use strat_store::{claim::Mark, files};

use super::{StudyError, curves::Curves};
use crate::{
    draw::png,
    evaluate::{ownership, plan, write},
    rows::{compare::protocols_of, study},
};

/// The record of a folder with a study's answer.
pub const RECORD: &str = "study-results.yaml";
/// The folder of curves.
pub const CURVES: &str = "curves";
/// The numbers of the curves, in their folder.
pub const CURVES_TABLE: &str = "curves.csv";
/// The folder of pictures of what models make of images.
pub const FIGURES: &str = "figures";

const ANSWER: &str = "answer.txt";
const VARIANTS: &str = "variants.csv";
const DIFFERENCES: &str = "differences.csv";

/// PNG pixels for each unit of the SVG.
const ZOOM: f32 = 2.0;

/// Whose a folder with a study's answer is. The rows beside it are those of `bench --table`.
pub const MARK: Mark = Mark {
    command: "bench study",
    record: RECORD,
    begins: "tool: bench study\n",
    writes: |name| {
        let own = [RECORD, ANSWER, VARIANTS, DIFFERENCES, CURVES, FIGURES];
        own.contains(&name) || is_ablation(name) || (ownership::MARK.writes)(name)
    },
};

fn is_ablation(name: &str) -> bool {
    let ends = [".txt", ".md", ".tex"];
    name.starts_with("ablation_") && ends.iter().any(|end| name.ends_with(end))
}

/// What is asked of rows.
#[derive(Clone, Copy, Debug)]
pub struct Question {
    /// The metric of the sentences.
    pub metric: Metric,
    /// The difference whose cost is told, in the unit of each metric.
    pub effect: f64,
}

/// The answer that rows give.
pub struct Answer {
    studies: Vec<Study>,
    ablations: Vec<Table>,
    text: String,
}

impl Answer {
    /// Works out everything that rows say.
    ///
    /// # Errors
    /// Rows that do not make a study or a table.
    pub fn of(rows: &[Row], coverage: &Coverage, asked: Question) -> Result<Self, StudyError> {
        let studies = study::studies(rows, asked.effect)?;
        let names = protocols_of(rows);
        let ablations = shown(&names)
            .into_iter()
            .map(|table| tables::ablation(table, &studies, rows, coverage))
            .collect::<Result<Vec<_>, _>>()
            .map_err(write::WriteError::from)?;
        let text = study::answer(&studies, asked.metric);
        Ok(Self {
            studies,
            ablations,
            text,
        })
    }

    /// What is known under each protocol.
    #[must_use]
    pub fn studies(&self) -> &[Study] {
        &self.studies
    }

    /// The ablations in the shape of the thesis' tables.
    #[must_use]
    pub fn ablations(&self) -> &[Table] {
        &self.ablations
    }

    /// Ablations and sentences, for a terminal.
    #[must_use]
    pub fn text(&self) -> String {
        let tables = self.ablations.iter().map(Table::text);
        let texts: Vec<String> = tables.chain([self.text.clone()]).collect();
        texts.join("\n")
    }

    /// Whether there are two variants to compare.
    #[must_use]
    pub fn has_pairs(&self) -> bool {
        study::has_pairs(&self.studies)
    }

    /// Writes all files that follow from rows alone.
    ///
    /// # Errors
    /// A file cannot be written.
    pub fn write(&self, out: &Path) -> Result<(), StudyError> {
        for name in files::names_in(out)? {
            if is_ablation(&name.to_string_lossy()) {
                files::remove(&out.join(name))?;
            }
        }
        for table in &self.ablations {
            let stem = format!(
                "ablation_{}",
                table.id().to_string().replace(['.', '-'], "_")
            );
            for (extension, text) in [
                ("txt", table.text()),
                ("md", table.markdown()),
                ("tex", table.latex()),
            ] {
                let path = out.join(format!("{stem}.{extension}"));
                files::write_atomic(&path, text.as_bytes())?;
            }
        }
        let variants = study::variants_csv(&self.studies)?;
        files::write_atomic(&out.join(VARIANTS), &variants)?;
        let differences = study::differences_csv(&self.studies)?;
        files::write_atomic(&out.join(DIFFERENCES), &differences)?;
        Ok(files::write_atomic(
            &out.join(ANSWER),
            self.text.as_bytes(),
        )?)
    }
}

/// Tables with numbers over all pixels of an image that show one of these protocols as their own.
fn shown(protocols: &[String]) -> Vec<ThesisTable> {
    let mut tables = plan::tables_showing(protocols.iter().map(String::as_str));
    tables.retain(|table| {
        let mut own = table.protocols().iter();
        *table != ThesisTable::Table32 && own.any(|name| protocols.iter().any(|p| p == name))
    });
    tables
}

/// Draws the curves and writes their numbers; nothing where there are none.
///
/// # Errors
/// A file cannot be written.
pub fn curves(curves: &Curves, out: &Path) -> Result<(), StudyError> {
    if curves.is_empty() {
        return Ok(());
    }
    let folder = out.join(CURVES);
    files::make_folder(&folder)?;
    files::write_atomic(&folder.join(CURVES_TABLE), &curves.csv()?)?;
    for (name, svg) in curves.charts() {
        files::write_atomic(&folder.join(format!("{name}.svg")), svg.as_bytes())?;
        let picture = png::png(&svg, ZOOM)?;
        files::write_atomic(&folder.join(format!("{name}.png")), &picture)?;
    }
    Ok(())
}
