//! The thesis' own tables and what newer models say of themselves, as data, from
//! `bench/published/*.csv`.
//!
//! Figures are kept as printed, also where they look wrong (PROTOCOL 6); what a reader should
//! know of a row is in its note.

use std::sync::LazyLock;

use crate::columns::{self, CsvError};
use crate::metrics::{FurtherMetric, Metric};
use crate::protocol::Group;
use crate::thesis::ThesisTable;

/// The thesis that the rows of its tables are taken from.
pub const THESIS: &str =
    "I. Mehta, Adversarial Training for Unsupervised Monocular Depth Estimation, MSc thesis";

/// A mark behind a method's name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Marker {
    /// Monocular video in table 3.1, supervision by depth in table 3.3.
    Star,
    /// Synthetic images with depth.
    Dagger,
}

/// A printed line of table 3.1 or 3.3, or of a model's own paper or README.
#[derive(Clone, Debug, PartialEq)]
pub struct PublishedRow {
    /// Table it stands in.
    pub table: ThesisTable,
    /// Number of the line, from 1.
    pub row: u32,
    /// Protocol under which comparable figures are measured.
    pub protocol: String,
    /// Method as printed.
    pub method: String,
    /// Number in the thesis' list of references; none for its own rows.
    pub reference: Option<u32>,
    /// What the method was trained with.
    pub supervision: String,
    /// Mark behind the name.
    pub marker: Option<Marker>,
    /// Printed in grey: published after the thesis' paper.
    pub grey: bool,
    /// Evaluated with the crop the table is about.
    pub comparable: bool,
    /// The group of pixels, under protocols with groups.
    pub group: Option<Group>,
    /// The seven figures; the thesis prints them all.
    pub metrics: [Option<f64>; 7],
    /// RMSE over all pixels of all images, metres.
    pub pooled_rmse: Option<f64>,
    /// Further metrics, where they were printed.
    pub further: [Option<f64>; 5],
    /// The work that the row is taken from, where it is not the thesis.
    pub source: Option<String>,
    /// What a reader should know.
    pub note: Option<String>,
}

/// A printed cell of table 3.2.
#[derive(Clone, Debug, PartialEq)]
pub struct PublishedGroup {
    /// Protocol under which comparable figures are measured.
    pub protocol: String,
    /// Method as printed.
    pub method: String,
    /// Number in the thesis' list of references; none for its own columns.
    pub reference: Option<u32>,
    /// Row of the table.
    pub group: Group,
    /// The figure, metres.
    pub rmse: f64,
}

impl PublishedRow {
    /// Key of the work in `bench/published/references.bib`, where it has one.
    pub fn cite_key(&self) -> Option<&'static str> {
        cite_key(self.reference, &self.method)
    }

    /// Where the figures stand.
    pub fn citation(&self) -> String {
        match &self.source {
            Some(source) => source.clone(),
            None => cite(self.table, Some(self.row), self.reference),
        }
    }
}

impl PublishedGroup {
    /// Where the figure stands.
    pub fn citation(&self) -> String {
        cite(ThesisTable::Table32, None, self.reference)
    }
}

/// Key in `bench/published/references.bib` of a method with its number in the thesis' list of
/// references; of the thesis' own rows that of its paper.
pub(crate) fn cite_key(reference: Option<u32>, method: &str) -> Option<&'static str> {
    const NUMBERED: [(u32, &str); 11] = [
        (3, "aleotti2018"),
        (7, "atapour2018"),
        (16, "eigen2014"),
        (19, "garg2016"),
        (21, "godard2017"),
        (39, "kuznietsov2017"),
        (47, "liu2016"),
        (59, "poggi2018"),
        (83, "yang2018"),
        (86, "zhan2018"),
        (90, "zhou2017"),
    ];
    const NAMED: [(&str, &str); 8] = [
        ("Ours - ", "mehta2018"),
        ("BTS ", "lee2019"),
        ("DPT-Hybrid", "ranftl2021"),
        ("NeW CRFs", "yuan2022"),
        ("Depth Anything", "yang2024"),
        ("Marigold + E2E", "garcia2025"),
        ("GeoWizard + E2E", "garcia2025"),
        ("Stable Diffusion + E2E", "garcia2025"),
    ];
    match reference {
        Some(number) => NUMBERED.iter().find(|(known, _)| *known == number),
        None => {
            let found = NAMED.iter().find(|(start, _)| method.starts_with(start));
            return found.map(|(_, key)| *key);
        }
    }
    .map(|(_, key)| *key)
}

fn cite(table: ThesisTable, row: Option<u32>, reference: Option<u32>) -> String {
    let mut text = format!("{THESIS}, table {table}");
    if let Some(row) = row {
        text += &format!(", row {row}");
    }
    if let Some(reference) = reference {
        text += &format!(", quoting its reference [{reference}]");
    }
    text
}

/// Lines of table 3.1 or 3.3 in printed order, or of newer models; none for table 3.2, see
/// [`groups`], and for Make3D.
pub fn rows(table: ThesisTable) -> &'static [PublishedRow] {
    static TABLE_3_1: LazyLock<Vec<PublishedRow>> = LazyLock::new(|| {
        let text = include_str!("../../published/table_3_1.csv");
        built_in(parse_rows(ThesisTable::Table31, text))
    });
    static TABLE_3_3: LazyLock<Vec<PublishedRow>> = LazyLock::new(|| {
        let text = include_str!("../../published/table_3_3.csv");
        built_in(parse_rows(ThesisTable::Table33, text))
    });
    static EIGEN_652: LazyLock<Vec<PublishedRow>> =
        LazyLock::new(|| built_in(parse_own(include_str!("../../published/eigen_652.csv"))));
    match table {
        ThesisTable::Eigen652 => &EIGEN_652,
        ThesisTable::Table31 => &TABLE_3_1,
        ThesisTable::Table32 | ThesisTable::Make3d => &[],
        ThesisTable::Table33 => &TABLE_3_3,
    }
}

/// Cells of table 3.2, method by method in printed order.
pub fn groups() -> &'static [PublishedGroup] {
    static TABLE_3_2: LazyLock<Vec<PublishedGroup>> = LazyLock::new(|| {
        let text = include_str!("../../published/table_3_2.csv");
        built_in(parse_groups(text))
    });
    &TABLE_3_2
}

fn built_in<T>(parsed: Result<T, CsvError>) -> T {
    // Part of the program and read by its tests, not input.
    parsed.expect("the published tables built into the program are well formed")
}

fn parse_rows(table: ThesisTable, text: &str) -> Result<Vec<PublishedRow>, CsvError> {
    const COLUMNS: [&str; 16] = [
        "row",
        "protocol",
        "method",
        "reference",
        "supervision",
        "marker",
        "grey",
        "comparable",
        "abs_rel",
        "sq_rel",
        "rmse",
        "rmse_log",
        "a1",
        "a2",
        "a3",
        "note",
    ];
    columns::read(text.as_bytes(), &COLUMNS, &[], |fields| {
        Ok(PublishedRow {
            table,
            row: fields.value("row", "a number")?,
            protocol: fields.required("protocol")?,
            method: fields.required("method")?,
            reference: fields.optional("reference", "empty or a number")?,
            supervision: fields.required("supervision")?,
            marker: match fields.text("marker").as_str() {
                "" => None,
                "star" => Some(Marker::Star),
                "dagger" => Some(Marker::Dagger),
                _ => return Err(fields.error("marker", "empty, star or dagger")),
            },
            grey: fields.value("grey", "true or false")?,
            comparable: fields.value("comparable", "true or false")?,
            group: None,
            pooled_rmse: None,
            metrics: fields
                .measures(Metric::ALL.map(Metric::name))?
                .map_or([None; 7], |values| values.map(Some)),
            further: [None; 5],
            source: None,
            note: fields.optional_text("note"),
        })
    })
}

/// What works say of their own models.
fn parse_own(text: &str) -> Result<Vec<PublishedRow>, CsvError> {
    const COLUMNS: [&str; 14] = [
        "protocol",
        "method",
        "citation",
        "supervision",
        "abs_rel",
        "sq_rel",
        "rmse",
        "rmse_log",
        "a1",
        "a2",
        "a3",
        "silog",
        "log10",
        "note",
    ];
    let mut rows = columns::read(text.as_bytes(), &COLUMNS, &[], |fields| {
        let mut metrics = [None; 7];
        for (value, metric) in metrics.iter_mut().zip(Metric::ALL) {
            *value = fields.optional_measure(metric.name())?;
        }
        let mut further = [None; 5];
        for metric in [FurtherMetric::Silog, FurtherMetric::Log10] {
            further[metric as usize] = fields.optional_measure(metric.name())?;
        }
        Ok(PublishedRow {
            table: ThesisTable::Eigen652,
            row: 0,
            protocol: fields.required("protocol")?,
            method: fields.required("method")?,
            reference: None,
            supervision: fields.required("supervision")?,
            marker: None,
            grey: false,
            // Nobody has measured the protocols of these works beside the ones here.
            comparable: false,
            group: None,
            pooled_rmse: None,
            metrics,
            further,
            source: Some(fields.required("citation")?),
            note: fields.optional_text("note"),
        })
    })?;
    for (row, number) in rows.iter_mut().zip(1..) {
        row.row = number;
    }
    Ok(rows)
}

fn parse_groups(text: &str) -> Result<Vec<PublishedGroup>, CsvError> {
    const COLUMNS: [&str; 5] = ["protocol", "method", "reference", "group", "rmse"];
    columns::read(text.as_bytes(), &COLUMNS, &[], |fields| {
        Ok(PublishedGroup {
            protocol: fields.required("protocol")?,
            method: fields.required("method")?,
            reference: fields.optional("reference", "empty or a number")?,
            group: fields.value("group", "a group")?,
            rmse: fields.measure("rmse")?,
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::protocol::protocol;

    /// Column sums over the printed rows, so that no digit changes unnoticed. Recipe: sums over
    /// the seven columns of the thesis' table 3.1 and of both halves of table 3.3.
    #[test]
    fn the_figures_are_the_printed_ones() {
        let sums = |name: &str| {
            let all = rows(ThesisTable::Table31)
                .iter()
                .chain(rows(ThesisTable::Table33));
            let mut sums = [0.0; 7];
            for row in all.filter(|row| row.protocol == name) {
                for (sum, value) in sums.iter_mut().zip(row.metrics) {
                    *sum += value.unwrap();
                }
            }
            sums.map(|sum| (sum * 1000.0_f64).round() as u32)
        };
        assert_eq!(sums("kitti2015"), SUMS[0]);
        assert_eq!(sums("eigen-80"), SUMS[1]);
        assert_eq!(sums("eigen-50"), SUMS[2]);
        let rmse: f64 = groups().iter().map(|cell| cell.rmse).sum();
        assert_eq!((rmse * 1000.0).round() as u32, SUM_3_2);
    }
    const SUMS: [[u32; 7]; 3] = [
        [749, 7333, 35788, 1281, 4972, 5622, 5859],
        [1660, 13329, 62755, 2618, 8743, 10194, 10672],
        [872, 5703, 27021, 1406, 4782, 5568, 5823],
    ];
    const SUM_3_2: u32 = 91680;

    #[test]
    fn every_row_names_a_protocol_and_its_origin() {
        let (a, b) = (rows(ThesisTable::Table31), rows(ThesisTable::Table33));
        assert_eq!((a.len(), b.len(), groups().len()), (6, 17, 15));
        for row in a.iter().chain(b) {
            assert!(protocol(&row.protocol).is_some(), "{}", row.protocol);
            assert_eq!(row.reference.is_none(), row.method.starts_with("Ours"));
        }
        assert_eq!(
            a[1].citation(),
            "I. Mehta, Adversarial Training for Unsupervised Monocular Depth Estimation, MSc \
             thesis, table 3.1, row 2, quoting its reference [21]"
        );
        assert_eq!(b.iter().filter(|row| row.grey).count(), 3);
    }

    /// Rows of newer models belong to protocols of their table, and name the work they stand in.
    /// Recipe: sums over the columns as printed there.
    #[test]
    fn newer_models_are_cited_with_what_they_print() {
        let rows = rows(ThesisTable::Eigen652);
        let own = ThesisTable::Eigen652.protocols();
        for row in rows {
            assert!(own.contains(&row.protocol.as_str()), "{}", row.protocol);
            assert!(row.citation().contains("github.com/"), "{}", row.citation());
            assert!(!row.comparable && row.metrics[0].is_some());
        }
        let sum = |values: &mut dyn Iterator<Item = Option<f64>>| {
            (10_000.0 * values.flatten().sum::<f64>()).round() as u32
        };
        assert_eq!(sum(&mut rows.iter().map(|row| row.metrics[0])), 6300);
        assert_eq!(sum(&mut rows.iter().map(|row| row.metrics[2])), 148_996);
        assert_eq!(sum(&mut rows.iter().map(|row| row.metrics[4])), 57_810);
        assert_eq!(sum(&mut rows.iter().map(|row| row.further[0])), 420_119);
    }
}
