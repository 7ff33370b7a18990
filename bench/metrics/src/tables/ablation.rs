//! The variants of a study in the shape of Tables 3.1 and 3.3: a line for each, mean and standard deviation
//! over its seeds.

use super::coverage::{Coverage, Source};
use super::error::TableError;
use super::methods::{metric_columns, range_of};
use super::notes::first_line;
use super::part::{Part, one_data_set};
use super::table::{Cell, Line, Section, Table, mark_best, plain};
use crate::metrics::Metric;
use crate::rows::Row;
use crate::study::{Study, Variant};
use crate::thesis::ThesisTable;

/// Builds the table of all variants under the protocols of a table, over the images that all models have.
/// `studies` are made of the same rows; protocols without one have no section.
///
/// # Errors
/// Rows that cannot stand in one table; see [`TableError`].
pub fn ablation(
    table: ThesisTable,
    studies: &[Study],
    rows: &[Row],
    coverage: &Coverage,
) -> Result<Table, TableError> {
    let found: Vec<(&Study, &'static str)> = table
        .protocols()
        .iter()
        .filter_map(|own| Some((studies.iter().find(|study| study.protocol == *own)?, *own)))
        .collect();
    let parts: Vec<Part<'_>> = found
        .iter()
        .map(|(study, own)| Part::new(&study.protocol, own, rows, coverage))
        .collect::<Result<_, _>>()?;
    one_data_set(&parts)?;
    let mut columns = vec![
        plain("variant", "Variant", false),
        plain("seeds", "Seeds", true),
        plain("images", "Images", false),
    ];
    columns.extend(metric_columns(
        found.first().map_or("", |(study, _)| &study.protocol),
    ));
    let mut built = Table {
        id: table,
        ablation: true,
        first_line: format!("Ablation. {}", first_line(table, &parts, coverage)),
        remarks: match coverage.source {
            Source::Kitti => Vec::new(),
            _ => vec![format!("The images are {}, not KITTI.", coverage.source)],
        },
        columns,
        sections: Vec::new(),
        notes: vec![
            "Mean ± standard deviation between seeds, of which each number is a mean over images."
                .to_owned(),
        ],
        resampled: None,
        has_further: false,
    };
    for ((study, _), part) in found.iter().zip(&parts) {
        // Groups of pixels have tables of their own.
        let Some(all) = study.parts.iter().find(|part| part.group.is_none()) else {
            continue;
        };
        let heading = (found.len() > 1).then(|| range_of(&study.protocol));
        let mut section: Section = part.section(heading);
        section.lines = all
            .variants
            .iter()
            .map(|variant| line(variant, all.images, part.expected))
            .collect();
        for (index, metric) in Metric::ALL.into_iter().enumerate() {
            let cells = section
                .lines
                .iter_mut()
                .filter_map(|line| line.cells.get_mut(3 + index));
            mark_best(cells, metric.lower_is_better());
        }
        built.sections.push(section);
    }
    Ok(built)
}

fn line(variant: &Variant, images: u64, expected: u64) -> Line {
    let seeds = variant.seeds.len();
    let mut cells = vec![
        Cell::text(&variant.name),
        Cell {
            value: Some(seeds as f64),
            ..Cell::text(if seeds == 0 {
                "-".to_owned()
            } else {
                seeds.to_string()
            })
        },
        Cell {
            value: Some(images as f64),
            ..Cell::text(format!("{images}/{expected}"))
        },
    ];
    cells.extend(Metric::ALL.map(|metric| {
        let values: Vec<f64> = variant
            .by_seed
            .iter()
            .map(|seed| seed[metric as usize])
            .collect();
        match values.as_slice() {
            [one] => Cell::figure(Some(*one)),
            values => Cell::spread(values),
        }
    }));
    Line {
        measured: true,
        comparable: true,
        cells,
        ..Line::default()
    }
}
