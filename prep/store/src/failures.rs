//! Failures of many items as few lines: the first of each kind when it happens, the rest as a count at the end.
//!
//! One mistake, such as a folder that is not where it was, hits every image of a run. A kind is a reason without
//! the names in it.

use crate::human;

/// Failures by kind, in the order in which kinds appeared.
#[derive(Debug, Default)]
pub struct Failures {
    kinds: Vec<(String, Vec<String>)>,
}

impl Failures {
    /// Takes down that `name` failed for a `reason`, which may name it, or a path that it is the end of. The
    /// sentence, to be said at once, is that of the first failure of a kind.
    pub fn add(&mut self, name: &str, reason: &str) -> Option<String> {
        let sentence = match reason.contains(name) {
            true => reason.to_owned(),
            false => format!("{name}: {reason}"),
        };
        let kind = without_names(&sentence, name);
        let names = self.kinds.iter_mut().find(|(known, _)| *known == kind);
        if let Some((_, names)) = names {
            names.push(name.to_owned());
            return None;
        }
        self.kinds.push((kind, vec![name.to_owned()]));
        Some(sentence)
    }

    /// A sentence for each kind that hit more than one item.
    pub fn repeated(&self) -> Vec<String> {
        let repeated = self.kinds.iter().filter(|(_, names)| names.len() > 1);
        repeated
            .map(|(kind, names)| {
                format!(
                    "{} failed like this ({}): {kind}",
                    names.len(),
                    human::first_three(names).unwrap_or_default()
                )
            })
            .collect()
    }
}

/// A sentence whose words that hold a name, or any part of the name's path, are dots.
fn without_names(sentence: &str, name: &str) -> String {
    let stem = name.rsplit('/').next().unwrap_or(name);
    let stem = stem.rsplit_once('.').map_or(stem, |(stem, _)| stem);
    let words = sentence.split(' ').map(|word| match holds(word, stem) {
        true => "...",
        false => word,
    });
    words.collect::<Vec<_>>().join(" ")
}

/// Whether a word holds a name that is not a part of another name or number.
fn holds(word: &str, name: &str) -> bool {
    let goes_on = |c: Option<char>| c.is_some_and(char::is_alphanumeric);
    word.match_indices(name).any(|(at, _)| {
        let (before, after) = (&word[..at], &word[at + name.len()..]);
        !name.is_empty() && !goes_on(before.chars().next_back()) && !goes_on(after.chars().next())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_mistake_is_one_line_and_a_count() {
        let mut failures = Failures::default();
        let missing = |name: &str| format!("cannot read set/image/{name}.png: it is not there");
        assert_eq!(
            failures.add("a/1", "cannot read set/image/a/1.png: it is not there"),
            Some("cannot read set/image/a/1.png: it is not there".to_owned())
        );
        for name in ["a/2", "b/3", "b/4"] {
            assert_eq!(failures.add(name, &missing(name)), None);
        }
        assert!(failures.add("c", "it is all black").is_some());
        assert_eq!(
            failures.repeated(),
            ["4 failed like this (a/1, a/2, b/3, ...): cannot read ... it is not there"]
        );
    }

    #[test]
    fn a_number_that_holds_a_name_is_no_name() {
        let mut failures = Failures::default();
        let full = "no memory for 80000000000 bytes";
        assert!(failures.add("kitti2015/000000", full).is_some());
        assert_eq!(failures.add("kitti2015/000001", full), None);
        assert_eq!(failures.repeated().len(), 1);
    }
}
