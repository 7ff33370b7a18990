//! What there is to say about the rows of one model as a whole.

use std::collections::BTreeSet;

use strat_metrics::Row;

use super::agreement::Agreement;
use crate::notes::Notes;

/// What there is to say about the rows of one predictor.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Remark {
    /// How it lies beside the truth, in figures.
    Figure(String),
    /// Something to know.
    Note(String),
    /// Something that makes its rows doubtful.
    Warning(String),
}

impl Remark {
    /// Says it.
    pub fn say(self, notes: &mut Notes) {
        match self {
            Self::Figure(text) => notes.say(&text),
            Self::Note(text) => notes.note(&text),
            Self::Warning(text) => notes.warn(text),
        }
    }
}

/// All that there is to say about the rows of one predictor, whose agreement is not doubted again where it
/// `is_suspected` since the first images.
pub(super) fn remarks(
    name: &str,
    rows: &[Row],
    agreement: Option<Agreement>,
    gives_depth: bool,
    is_suspected: bool,
) -> Vec<Remark> {
    let mut remarks = Vec::new();
    if let Some(agreement) = agreement {
        remarks.push(Remark::Figure(format!("{name}: {}", agreement.text())));
        let doubts = agreement.doubts().into_iter().filter(|_| !is_suspected);
        remarks.extend(doubts.map(|doubt| Remark::Warning(format!("{name}: {doubt}"))));
    }
    // Of depth, these are figures of another set of pixels than those of other models.
    let counted = if gives_depth {
        Remark::Warning
    } else {
        Remark::Note
    };
    remarks.extend(misaligned(name, rows).into_iter().map(Remark::Warning));
    remarks.extend(unpredicted(name, rows, gives_depth).map(counted));
    remarks.extend(
        dead(name, rows)
            .filter(|_| !gives_depth)
            .map(Remark::Warning),
    );
    remarks
}

/// The images with the `count` smallest and `count` largest Abs Rel under the first protocol
/// that scores images as wholes.
pub(super) fn extremes(rows: &[Row], count: usize) -> BTreeSet<String> {
    let first = rows.iter().find(|row| row.score.group.is_none());
    let mut own: Vec<&Row> = rows
        .iter()
        .filter(|row| first.is_some_and(|first| first.context.protocol == row.context.protocol))
        .collect();
    own.sort_by(|a, b| {
        let error = |row: &Row| row.score.metrics.abs_rel;
        error(a).total_cmp(&error(b)).then(a.image.cmp(&b.image))
    });
    let ends = own.iter().take(count).chain(own.iter().rev().take(count));
    ends.map(|row| row.image.clone()).collect()
}

/// What there is to say about pixels without a usable prediction (PROTOCOL D8): how many there are,
/// and what that means for the figures.
fn unpredicted(name: &str, rows: &[Row], gives_depth: bool) -> Option<String> {
    let first = rows.iter().find(|row| row.score.floored_pixels > 0)?;
    let protocol = &first.context.protocol;
    let own = || rows.iter().filter(|row| row.context.protocol == *protocol);
    let sum = |count: fn(&Row) -> u64| own().map(count).sum::<u64>();
    let (missing, scored) = (
        sum(|row| row.score.floored_pixels),
        sum(|row| row.score.pixels),
    );
    Some(if gives_depth {
        format!(
            "{name}: {missing} of {} pixels under {protocol} have no depth (0 is none) and are left \
             out; numbers are of the other {:.1} % alone (columns pixels and floored_pixels of \
             rows.csv)",
            missing + scored,
            100.0 * scored as f64 / (missing + scored) as f64
        )
    } else {
        format!(
            "{name}: {missing} of {scored} pixels scored under {protocol} had a disparity of zero or \
             nearly zero and were scored at its floor, far away (column floored_pixels of rows.csv)"
        )
    })
}

/// Whether maps of disparity have none anywhere. Dead maps of depth fail and say so themselves.
fn dead(name: &str, rows: &[Row]) -> Option<String> {
    let first = rows.iter().find(|row| row.score.floored_pixels > 0)?;
    let dead: BTreeSet<&str> = rows
        .iter()
        .filter(|row| row.context.protocol == first.context.protocol)
        .filter(|row| row.score.floored_pixels == row.score.pixels)
        .map(|row| row.image.as_str())
        .collect();
    dead.first().map(|first| {
        format!(
            "DEAD OUTPUT: model {name} gives no disparity above the floor in {} of {} images, such as \
             {first}; its numbers say nothing about depth",
            dead.len(),
            images_in(rows)
        )
    })
}

/// What there is to say about alignments (PROTOCOL 10.1), protocol by protocol: images whose fitted
/// scale is below 0, and images whose prediction is the same everywhere.
fn misaligned(name: &str, rows: &[Row]) -> Vec<String> {
    let mut protocols: Vec<&str> = rows
        .iter()
        .filter(|row| row.score.fit.is_some())
        .map(|row| row.context.protocol.as_str())
        .collect();
    protocols.dedup();
    let mut texts = Vec::new();
    for protocol in protocols {
        let own = || rows.iter().filter(|row| row.context.protocol == protocol);
        let where_scale = |is: fn(f64) -> bool| -> BTreeSet<&str> {
            own()
                .filter(|row| row.score.fit.is_some_and(|fit| is(fit.scale)))
                .map(|row| row.image.as_str())
                .collect()
        };
        let images: BTreeSet<&str> = own().map(|row| row.image.as_str()).collect();
        let reversed = where_scale(|scale| scale < 0.0);
        if let Some(first) = reversed.first() {
            texts.push(format!(
                "NEGATIVE SCALE: model {name} under {protocol}: what is near is predicted as far in \
                 {} of {} images, such as {first} (column scale of rows.csv); is its output depth that \
                 is declared as `inverse_depth`, or the reverse?",
                reversed.len(),
                images.len()
            ));
        }
        let flat = where_scale(|scale| scale == 0.0);
        if let Some(first) = flat.first() {
            texts.push(format!(
                "FLAT OUTPUT: model {name} under {protocol}: what is aligned is the same everywhere in \
                 {} of {} images, such as {first}; their rows are those of a constant",
                flat.len(),
                images.len()
            ));
        }
    }
    texts
}

pub(super) fn images_in(rows: &[Row]) -> usize {
    let images: BTreeSet<&str> = rows.iter().map(|row| row.image.as_str()).collect();
    images.len()
}

#[cfg(test)]
mod tests {
    use strat_metrics::{Fit, ImageScore, Metrics, RowContext};

    use super::*;

    fn row(image: &str, abs_rel: f64, pixels: u64, floored_pixels: u64) -> Row {
        let context = RowContext {
            protocol: "eigen-80".to_owned(),
            ..RowContext::default()
        };
        let metrics = Metrics {
            abs_rel,
            sq_rel: 0.0,
            rmse: 0.0,
            rmse_log: 0.0,
            a1: 0.0,
            a2: 0.0,
            a3: 0.0,
        };
        let score = ImageScore {
            group: None,
            metrics,
            further: None,
            d1_all: None,
            sum_squared_error: 0.0,
            pixels,
            floored_pixels,
            fit: None,
        };
        Row::new(&context, image, score)
    }

    #[test]
    fn the_best_and_the_worst_images_are_chosen() {
        let rows = [("a", 0.3), ("b", 0.1), ("c", 0.2), ("d", 0.4)].map(|(id, e)| row(id, e, 1, 0));
        let chosen: Vec<String> = extremes(&rows, 1).into_iter().collect();
        assert_eq!(chosen, ["b", "d"]);
        assert_eq!(extremes(&rows, 9).len(), 4);
        assert!(extremes(&rows, 0).is_empty());
    }

    #[test]
    fn pixels_without_a_prediction_are_counted_by_what_becomes_of_them() {
        let rows = [row("a", 0.1, 70, 30), row("b", 0.1, 100, 0)];
        let depth = unpredicted("m", &rows, true).unwrap();
        assert!(
            depth.contains("30 of 200 pixels") && depth.contains("85.0 %"),
            "{depth}"
        );
        let disparity = unpredicted("m", &rows, false).unwrap();
        assert!(disparity.contains("30 of 170 pixels"), "{disparity}");
        assert_eq!(unpredicted("m", &rows[1..], true), None);
    }

    #[test]
    fn scales_of_no_sense_are_said_by_protocol() {
        let aligned = |image: &str, scale: f64| {
            let mut row = row(image, 0.1, 100, 0);
            row.score.fit = Some(Fit { scale, shift: 1.0 });
            row
        };
        let rows = [
            aligned("a", 2.0),
            aligned("b", -0.5),
            aligned("c", 0.0),
            aligned("d", -1.0),
        ];
        let texts = misaligned("m", &rows);
        assert_eq!(texts.len(), 2);
        assert!(
            texts[0].contains("in 2 of 4 images, such as b"),
            "{texts:?}"
        );
        assert!(
            texts[1].contains("in 1 of 4 images, such as c"),
            "{texts:?}"
        );
        assert!(misaligned("m", &rows[..1]).is_empty());
        assert!(misaligned("m", &[row("a", 0.1, 1, 0)]).is_empty());
    }

    #[test]
    fn a_map_without_any_disparity_is_dead() {
        let rows = [row("a", 0.1, 70, 70), row("b", 0.1, 100, 99)];
        let text = dead("m", &rows).unwrap();
        assert!(text.contains("in 1 of 2 images, such as a"), "{text}");
        assert_eq!(dead("m", &rows[1..]), None);
    }
}
