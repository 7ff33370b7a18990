//! Published numbers of a user's own, from a file in the leaderboard's columns.
//!
//! Not here: the numbers that come with the program ([`crate::published`]).

use std::io::Read;

use crate::columns::{self, CsvError};
use crate::leaderboard;
use crate::metrics::{FurtherMetric, Metric};
use crate::protocol::{Group, protocol as rules_of};
use crate::published::PublishedRow;
use crate::thesis::ThesisTable;

/// Published numbers of a user's own: CSV with columns of a leaderboard, of which `protocol`, `method` and
/// `citation` are needed, and `group` under protocols with groups (table 3.2). They are never ranked:
/// nothing is known of how they were measured.
///
/// # Errors
/// A column is unknown or missing, or a value cannot stand in its column.
pub fn read(reader: impl Read) -> Result<Vec<PublishedRow>, CsvError> {
    const NEEDED: [&str; 3] = ["protocol", "method", "citation"];
    let optional: Vec<&'static str> = leaderboard::COLUMNS
        .into_iter()
        .filter(|column| !NEEDED.contains(column))
        .collect();
    columns::read(reader, &leaderboard::COLUMNS, &optional, |fields| {
        let protocol = fields.required("protocol")?;
        let (table, _) = ThesisTable::showing(&protocol)
            .ok_or_else(|| fields.error("protocol", "a protocol that a table is about"))?;
        let groups = rules_of(&protocol).map_or(&[][..], |rules| rules.grouping.groups());
        let group: Option<Group> = fields.optional("group", "a group of pixels, or empty")?;
        match group {
            Some(group) if !groups.contains(&group) => {
                return Err(fields.error("group", "a group of pixels of this protocol"));
            }
            None if !groups.is_empty() => {
                return Err(fields.error("group", "a group of pixels, one line for each"));
            }
            _ => {}
        }
        let mut metrics = [None; 7];
        for (value, metric) in metrics.iter_mut().zip(Metric::ALL) {
            *value = fields.optional_measure(metric.name())?;
        }
        let mut further = [None; 5];
        for (value, metric) in further.iter_mut().zip(FurtherMetric::ALL) {
            *value = fields.optional_measure(metric.name())?;
        }
        Ok(PublishedRow {
            table,
            row: 0,
            protocol,
            method: fields.required("method")?,
            reference: None,
            supervision: "-".to_owned(),
            marker: None,
            grey: false,
            comparable: false,
            group,
            pooled_rmse: fields.optional_measure("rmse_pooled")?,
            metrics,
            further,
            source: Some(fields.required("citation")?),
            note: None,
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn published_numbers_of_ones_own_need_few_columns() {
        let text = "method,protocol,citation,abs_rel,a1\nMine,eigen-80,\"A. B., 2024\",0.1,0.9\n";
        let rows = read(text.as_bytes()).unwrap();
        assert_eq!(rows[0].table, ThesisTable::Table33);
        assert_eq!(
            (rows[0].metrics[0], rows[0].metrics[4]),
            (Some(0.1), Some(0.9))
        );
        assert_eq!(rows[0].metrics[1], None);
        let text =
            "method,protocol,group,citation,rmse,rmse_pooled\nMine,semantic,flat,c,2.1,2.5\n";
        let rows = read(text.as_bytes()).unwrap();
        assert_eq!(rows[0].table, ThesisTable::Table32);
        assert_eq!(
            (rows[0].group, rows[0].pooled_rmse),
            (Some(Group::Flat), Some(2.5))
        );
        for (wrong, part) in [
            (
                "method,protocol,group,citation\nm,semantic,,c\n",
                "a group of pixels, one line for each",
            ),
            (
                "method,protocol,group,citation\nm,eigen-80,flat,c\n",
                "a group of pixels of this protocol",
            ),
            ("method,protocol\n", "citation"),
            (
                "method,protocol,citation\nm,none,c\n",
                "a protocol that a table is about",
            ),
            ("method,protocol,citation,abs\n", "abs"),
        ] {
            let error = read(wrong.as_bytes()).unwrap_err().to_string();
            assert!(error.contains(part), "{error}");
        }
    }
}
