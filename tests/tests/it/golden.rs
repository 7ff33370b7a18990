//! Golden values in unit tests are what their recipe in `tests/oracle/make_golden.py` makes.

use std::collections::{BTreeMap, BTreeSet};

use serde_json::Value;

use crate::python::oracle;
use crate::sources::{files, root};

const NAMED: &str = "make_golden.py ";

/// The recipes that a file names.
fn named(text: &str) -> impl Iterator<Item = &str> {
    text.match_indices(NAMED).filter_map(|(at, _)| {
        let rest = &text[at + NAMED.len()..];
        let end = rest
            .find(|c: char| !c.is_ascii_alphanumeric() && !"-/".contains(c))
            .unwrap_or(rest.len());
        rest[..end].contains('/').then(|| &rest[..end])
    })
}

/// Unsigned numbers in Rust text, without underscores and types.
fn numbers(text: &str) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    let bytes = text.as_bytes();
    let mut at = 0;
    while at < bytes.len() {
        let begins = bytes[at].is_ascii_digit()
            && !(at > 0 && (bytes[at - 1].is_ascii_alphanumeric() || bytes[at - 1] == b'_'));
        let start = at;
        at += 1;
        while begins && at < bytes.len() {
            let part = bytes[at].is_ascii_alphanumeric()
                || bytes[at] == b'_'
                || (bytes[at] == b'.' && bytes.get(at + 1).is_some_and(u8::is_ascii_digit))
                || (bytes[at] == b'-' && bytes[at - 1] == b'e');
            if !part {
                break;
            }
            at += 1;
        }
        if begins {
            found.insert(text[start..at].replace('_', ""));
        }
    }
    found
}

/// Whether one of the literals says this value: whole numbers exactly, others to 1e-6.
fn says(literals: &BTreeSet<String>, text: &str, value: &Value) -> bool {
    if let Some(word) = value.as_str() {
        return text.contains(word);
    }
    if let Some(whole) = value.as_u64() {
        return literals.contains(&whole.to_string());
    }
    let value = value.as_f64().expect("a number").abs();
    let near = |literal: &String| {
        literal
            .parse()
            .is_ok_and(|n: f64| (n - value).abs() <= 1e-6 * value.max(1.0))
    };
    literals.iter().any(near)
}

#[test]
fn golden_values_are_those_of_their_recipes() {
    let script =
        std::fs::read_to_string(root().join("tests/oracle/make_golden.py")).expect("the recipes");
    let recipes: BTreeSet<&str> = script
        .lines()
        .filter_map(|line| line.strip_prefix("@recipe(\"")?.strip_suffix("\")"))
        .collect();
    let sources = files(&["rs"]);
    let users: Vec<_> = sources
        .iter()
        .filter(|(path, _)| !path.ends_with("golden.rs"))
        .collect();
    let cited: BTreeSet<&str> = users.iter().flat_map(|(_, text)| named(text)).collect();
    assert_eq!(
        cited, recipes,
        "recipes that tests name, and recipes that exist"
    );

    let Some(made) = oracle("make_golden.py", &[]) else {
        return;
    };
    let made: BTreeMap<String, Vec<Value>> = serde_json::from_str(&made).expect("JSON");
    assert!(made.len() > 10, "only {:?} were made", made.keys());
    for (path, text) in users {
        let literals = numbers(text);
        for name in named(text) {
            // What is left out needs a package that is not there.
            for value in made.get(name).into_iter().flatten() {
                assert!(
                    says(&literals, text, value),
                    "{}: {name} gives {value}, which is not there",
                    path.display()
                );
            }
        }
    }
}

#[test]
fn literals_are_read() {
    let found = numbers("[0.177_075_697, 1e-9_f64, 12_u8, a1, 0..5] // 7");
    let expected = ["0.177075697", "1e-9f64", "12u8", "0", "5", "7"].map(str::to_owned);
    assert_eq!(found, BTreeSet::from(expected));
}

/// The fits against numpy's solver, and maps of known scale.
#[test]
fn the_oracle_aligns_as_it_states() {
    if let Some(text) = oracle("alignment.py", &[]) {
        assert_eq!(text.trim(), "the fits are right");
    }
}
