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
    let mut sums: BTreeMap<u32, (f64, f64, f64)> = BTreeMap::new();
    for series in drawn {
        for (&step, row) in *series {
            let sum = sums.entry(step).or_default();
            sum.0 += x(row);
            sum.1 += y(row);
            sum.2 += 1.0;
        }
    }
    sums.into_values()
        .map(|(x, y, count)| (x / count, y / count))
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
