//! Downloads: all lines, and each section with its ranks.

use strat_metrics::leaderboard::{self, Entry};
use strat_metrics::{CsvError, Metric};

use super::memory::Site;
use crate::board::BoardError;
use crate::check::Checked;
use crate::section::Section;

pub(super) fn add(
    site: &mut Site,
    checked: &Checked,
    sections: &[Section<'_>],
) -> Result<(), BoardError> {
    let lines = checked
        .submissions
        .iter()
        .flat_map(|one| &one.scored)
        .flat_map(|one| &one.parts);
    let lines: Vec<Entry> = lines.map(|part| part.line.clone()).collect();
    let mut bytes = Vec::new();
    leaderboard::write(&leaderboard::merge([lines])?, &mut bytes)?;
    site.add("csv/leaderboard.csv", bytes);
    for section in sections {
        site.add(format!("csv/{}.csv", section.id), table(section)?);
    }
    Ok(())
}

fn table(section: &Section<'_>) -> Result<Vec<u8>, BoardError> {
    let mut header: Vec<String> = [
        "submission",
        "method",
        "supervision",
        "images",
        "expected_images",
        "leakage",
    ]
    .map(str::to_owned)
    .to_vec();
    for metric in Metric::ALL {
        let name = metric.name();
        header.extend([
            name.to_owned(),
            format!("{name}_low"),
            format!("{name}_high"),
            format!("{name}_rank"),
            format!("{name}_p_holm"),
        ]);
    }
    let text = |value: Option<f64>| value.map_or(String::new(), |value| value.to_string());
    let mut csv = strat_csv::Writer::new(Vec::new());
    csv.write_record(&header).map_err(CsvError::from)?;
    for method in &section.methods {
        let line = &method.measured.line;
        let mut cells = vec![
            method.submission.id.clone(),
            method.submission.card.method.clone(),
            method.submission.card.supervision.clone(),
            method.scored.images.to_string(),
            section.of_split.to_string(),
            method.scored.leakage.to_string(),
        ];
        for metric in Metric::ALL {
            let index = metric as usize;
            let interval = line.intervals[index];
            let place = method.places[index];
            cells.extend([
                text(line.metrics[index]),
                text(interval.map(|interval| interval.low)),
                text(interval.map(|interval| interval.high)),
                place.rank.map_or(String::new(), |rank| rank.to_string()),
                text(place.p_holm),
            ]);
        }
        csv.write_record(&cells).map_err(CsvError::from)?;
    }
    Ok(csv.into_inner().map_err(CsvError::from)?)
}
