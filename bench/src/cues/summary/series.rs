//! Rows of one condition as curves over their steps.

use std::collections::BTreeMap;

use crate::cues::rows::{Condition, CueRow};

/// A series of one background by step.
pub(in crate::cues) type Series<'a> = BTreeMap<u32, &'a CueRow>;

/// The rows of one condition, by background.
pub(in crate::cues) fn series<'a>(
    rows: &[&'a CueRow],
    sprite: &str,
    condition: Condition,
) -> Vec<Series<'a>> {
    let mut found: BTreeMap<&str, Series<'a>> = BTreeMap::new();
    for row in rows {
        if row.sprite == sprite && row.condition == condition {
            found
                .entry(&row.background)
                .or_default()
                .insert(row.step, row);
        }
    }
    found.into_values().collect()
}

/// Mean over backgrounds of x and y at each step.
pub(super) fn mean_curve(
    drawn: &[&Series<'_>],
    x: impl Fn(&CueRow) -> f64,
    y: impl Fn(&CueRow) -> f64,
) -> Vec<(f64, f64)> {
    // By step. Series have mostly the same steps, so the place of the next one is found by going on from the last.
    let mut sums: Vec<(u32, [f64; 3])> = Vec::new();
    for series in drawn {
        let mut place = 0;
        for (&step, row) in *series {
            while sums.get(place).is_some_and(|(known, _)| *known < step) {
                place += 1;
            }
            if sums.get(place).is_none_or(|(known, _)| *known != step) {
                sums.insert(place, (step, [0.0; 3]));
            }
            let [of_x, of_y, count] = &mut sums[place].1;
            *of_x += x(row);
            *of_y += y(row);
            *count += 1.0;
        }
    }
    sums.into_iter()
        .map(|(_, [x, y, count])| (x / count, y / count))
        .collect()
}

/// Names in the order of their first row.
pub(crate) fn distinct<'a>(values: impl Iterator<Item = &'a str>) -> Vec<&'a str> {
    let mut names: Vec<&str> = Vec::new();
    for value in values {
        if !names.contains(&value) {
            names.push(value);
        }
    }
    names
}
