//! Every citation of PROTOCOL.md in the repository leads somewhere.

use std::collections::BTreeSet;

use crate::sources::{files, root};

/// Sections and decisions that PROTOCOL.md has: `3`, `3.5`, `D8`.
fn places() -> BTreeSet<String> {
    let text = std::fs::read_to_string(root().join("PROTOCOL.md")).expect("PROTOCOL.md");
    let heading = |line: &str| {
        let number = line.trim_start_matches('#').split_whitespace().next()?;
        line.starts_with('#')
            .then(|| number.trim_end_matches('.').to_owned())
    };
    let decision = |line: &str| {
        let id = line.strip_prefix("| ")?.split_whitespace().next()?;
        is_decision(id).then(|| id.to_owned())
    };
    text.lines()
        .filter_map(|line| heading(line).or_else(|| decision(line)))
        .collect()
}

fn is_decision(word: &str) -> bool {
    word.strip_prefix('D')
        .is_some_and(|n| !n.is_empty() && n.bytes().all(|b| b.is_ascii_digit()))
}

/// Text in which a comment that goes on in the next line is one line.
fn unwrapped(text: &str) -> String {
    let mut joined = String::with_capacity(text.len());
    for line in text.lines() {
        let line = line.trim_start();
        let mark = ["//!", "///", "//", "#"]
            .into_iter()
            .find_map(|mark| line.strip_prefix(mark));
        joined.push(if mark.is_some() { ' ' } else { '\n' });
        joined.push_str(mark.unwrap_or(line).trim());
    }
    joined
}

/// What follows each `PROTOCOL` up to the first word that continues no list of places.
fn citations(text: &str) -> Vec<String> {
    let mut found = Vec::new();
    for (at, _) in text.match_indices("PROTOCOL") {
        for word in text[at + "PROTOCOL".len()..].split_whitespace() {
            if word.starts_with('(') {
                break;
            }
            let bare = word.trim_matches(|c: char| !c.is_alphanumeric());
            let numbers: Vec<&str> = bare.split('-').collect();
            let is_place = |n: &&str| {
                is_decision(n)
                    || (!n.is_empty() && n.bytes().all(|b| b.is_ascii_digit() || b == b'.'))
            };
            if numbers.iter().all(is_place) {
                found.extend(numbers.into_iter().map(str::to_owned));
            } else if !["section", "sections", "and", "to", "decision", "decisions"].contains(&bare)
            {
                break;
            }
            if word.contains(')') || word.ends_with(['.', ':', ';']) {
                break;
            }
        }
    }
    found
}

#[test]
fn citations_lead_to_a_section_or_decision() {
    let places = places();
    let mut count = 0;
    for (path, text) in files(&["rs", "py", "md", "yaml"]) {
        for place in citations(&unwrapped(&text)) {
            assert!(
                places.contains(&place),
                "{} cites PROTOCOL {place}, which is not there",
                path.display()
            );
            count += 1;
        }
    }
    assert!(count > 100, "only {count} citations were found");
}

#[test]
fn citations_are_found() {
    let text = "/// As stated (PROTOCOL\n/// 2.1 and 2.6). See 9.9.\n//! PROTOCOL 5.1 to 5.3, decision D18.\nx";
    assert_eq!(
        citations(&unwrapped(text)),
        ["2.1", "2.6", "5.1", "5.3", "D18"]
    );
    assert_eq!(
        citations("PROTOCOL 1.1-1.3) PROTOCOL.md PROTOCOL: &str PROTOCOL section 4."),
        ["1.1", "1.3", "4"]
    );
    assert_eq!(
        citations("(PROTOCOL 4.5, decision D12), 7. PROTOCOL 3.1, 3.2 and 3.6 (8)"),
        ["4.5", "D12", "3.1", "3.2", "3.6"]
    );
}
