//! YAML files with errors that name the file, the line and the key.

use std::path::Path;

use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::error::{Error, Result};
use crate::guard::guarded;
use crate::human;
use crate::inputs::{self, Kind};

/// Most brackets that a text opens.
const MAX_BRACKETS: usize = 20_000;

/// Most bytes of a text that has aliases.
const LARGEST_WITH_ALIASES: usize = 16_384;

/// Reads a YAML file. Whether unknown keys are refused is up to `T`.
///
/// # Errors
/// The file cannot be read or does not fit `T`; the message has key path, line and column.
pub fn load<T: DeserializeOwned>(path: &Path) -> Result<T> {
    parse(&inputs::read(path, Kind::Yaml)?).map_err(|problem| Error::Yaml {
        path: path.to_owned(),
        problem,
    })
}

/// A value from YAML text of any origin.
///
/// # Errors
/// The text does not fit `T`, or is nested or repeated beyond what any settings need; the sentence
/// has key path, line and column.
pub fn parse<T: DeserializeOwned>(bytes: &[u8]) -> std::result::Result<T, String> {
    check(bytes)?;
    guarded("the YAML parser", || serde_yaml::from_slice(bytes))?
        .map_err(|error| plain(&error.to_string()))
}

/// A complaint of the parser in a user's words: nothing of the program's own types, at most a few letters of
/// what stands in the file, and the key that was probably meant.
#[must_use]
pub fn plain(complaint: &str) -> String {
    let mut text = complaint.to_owned();
    for kind in ["struct", "enum", "tuple struct", "newtype struct", "a map"] {
        let words = format!("expected {kind}");
        let Some(at) = text.find(&words) else {
            continue;
        };
        let after = at + words.len();
        let name = text[after..].strip_prefix(' ').map_or(0, |rest| {
            1 + rest
                .find(|c: char| !c.is_alphanumeric() && c != '_')
                .unwrap_or(rest.len())
        });
        // Of a map only the word, of a type its name as well.
        let end = if kind == "a map" { after } else { after + name };
        text.replace_range(at..end, "expected keys and values (`key: value`)");
    }
    // A whole file that is one string is quoted as such.
    if let Some(start) = text.find('"')
        && let Some(end) = text.rfind('"').filter(|end| *end > start + 40)
    {
        let quoted: String = text[start + 1..end].chars().take(24).collect();
        text.replace_range(start..=end, &format!("\"{} ...\"", quoted.trim_end()));
    }
    let quoted: Vec<&str> = text.split('`').skip(1).step_by(2).collect();
    if let [unknown, known @ ..] = quoted.as_slice()
        && text.contains("unknown field")
        && let Some(meant) = human::closest(unknown, known.iter().copied())
    {
        let advice = format!("unknown key `{unknown}`, did you mean `{meant}`?");
        let old = format!("unknown field `{unknown}`,");
        text = text.replacen(&old, &format!("{advice} Known here:"), 1);
    }
    text.replace("Known here: expected one of", "Known here:")
        .replace("Known here: expected", "Known here:")
}

/// Refuses what the parser would take minutes or gigabytes over: its work grows with the square of
/// the brackets that are open, and what aliases stand for is repeated up to a hundred times.
///
/// What closes brackets is not counted, because whether it lies within a string is known only to
/// the parser.
fn check(bytes: &[u8]) -> std::result::Result<(), String> {
    let brackets = bytes.iter().filter(|b| matches!(b, b'[' | b'{')).count();
    if brackets > MAX_BRACKETS {
        return Err(format!(
            "it opens {brackets} brackets; at most {MAX_BRACKETS} are read"
        ));
    }
    let names = |sign: u8| {
        let starts = |pair: &[u8]| pair[0] == sign && !pair[1].is_ascii_whitespace();
        bytes.windows(2).any(starts)
    };
    if bytes.len() > LARGEST_WITH_ALIASES && names(b'&') && names(b'*') {
        return Err(format!(
            "it has {} bytes and aliases (&name, *name); with them, at most {LARGEST_WITH_ALIASES} are read",
            bytes.len()
        ));
    }
    Ok(())
}

/// A value as YAML text.
///
/// # Errors
/// The value has a shape that YAML cannot hold.
pub fn to_string<T: Serialize>(value: &T) -> Result<String> {
    serde_yaml::to_string(value).map_err(|error| Error::ToYaml(error.to_string()))
}

#[cfg(test)]
mod tests {
    use serde::Deserialize;

    use super::*;

    #[test]
    fn nesting_and_repetition_are_refused_before_they_are_parsed() {
        type Any = serde_yaml::Value;
        for open in ["[", "{a: ", "[\"]\", "] {
            let problem = parse::<Any>(open.repeat(300_000).as_bytes()).unwrap_err();
            assert!(problem.contains("it opens 300000 brackets"), "{problem}");
        }
        // Without brackets, the parser's own limit stands.
        for open in ["- ", "? "] {
            let problem = parse::<Any>(open.repeat(300_000).as_bytes()).unwrap_err();
            assert!(problem.contains("recursion limit"), "{problem}");
        }
        let filler = "x, ".repeat(8_000);
        let repeated = format!("a: &a [{filler}]\nb: [*a, *a, *a]");
        let problem = parse::<Any>(repeated.as_bytes()).unwrap_err();
        assert!(problem.contains("aliases"), "{problem}");
        // Small ones are read, and so are signs that name nothing.
        let small: Vec<Vec<u8>> = parse(b"[&a [1, 2], *a]").unwrap();
        assert_eq!(small, [[1, 2], [1, 2]]);
        assert!(parse::<Any>(format!("a: [{filler}] # 2 & 3 * 4").as_bytes()).is_ok());
    }

    #[test]
    fn complaints_are_in_a_users_words() {
        let problem = |text: &str| parse::<Config>(text.as_bytes()).unwrap_err();
        let whole = problem(&"a text that is no settings at all ".repeat(40));
        assert!(whole.len() < 200 && !whole.contains("struct"), "{whole}");
        assert!(whole.contains("expected keys and values"), "{whole}");
        let mistyped = problem("epoch: 3");
        assert!(mistyped.contains("did you mean `epochs`?"), "{mistyped}");
        let other = problem("zebra: 3");
        assert!(
            other.contains("zebra") && !other.contains("did you mean"),
            "{other}"
        );
    }

    #[derive(Debug, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Config {
        epochs: u32,
        loss: Loss,
    }

    #[derive(Debug, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Loss {
        ssim: f64,
    }

    #[test]
    fn values_survive_and_mistakes_are_located() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("config.yaml");
        let config = Config {
            epochs: 50,
            loss: Loss { ssim: 0.1 },
        };
        std::fs::write(&path, to_string(&config).unwrap()).unwrap();
        assert_eq!(load::<Config>(&path).unwrap(), config);

        std::fs::write(&path, "epochs: 50\nloss:\n  ssim: 1.0\n  l2: 3\n").unwrap();
        let error = load::<Config>(&path).unwrap_err().to_string();
        for part in ["config.yaml", "l2", "line 4", "loss"] {
            assert!(error.contains(part), "{part} is missing in: {error}");
        }
        assert!(
            load::<Config>(&folder.path().join("none.yaml"))
                .unwrap_err()
                .is_not_found()
        );
    }
}
