//! Texts of strangers: what may stand in a name, in prose, in an id, so that it is harmless in CSV,
//! HTML, a path and a terminal.
//!
//! Pages escape what they show and tables guard their cells; this is the door before them, where a
//! contributor can still be told.

/// Most letters of a name.
const LONGEST_NAME: usize = 80;

/// Most letters of prose.
const LONGEST_PROSE: usize = 1000;

/// Most letters of an image's id.
const LONGEST_ID: usize = 120;

/// Most letters of a folder's name.
const LONGEST_FOLDER: usize = 60;

/// Checks a name, of a method, a runtime or a version: letters, digits, spaces and a few signs.
///
/// # Errors
/// What is wrong with it, as the rest of a sentence that begins with the name.
pub(crate) fn check_name(text: &str) -> Result<(), String> {
    check_length(text, LONGEST_NAME)?;
    check_start(text)?;
    let odd = |c: &char| !(c.is_alphanumeric() || " -_.,:;()[]+*/@#&%".contains(*c));
    match text.chars().find(odd) {
        Some(odd) => Err(format!(
            "has the character {odd:?}; names may have letters, digits, spaces and -_.,:;()[]+*/@#&%"
        )),
        None => Ok(()),
    }
}

/// Checks a sentence or two.
///
/// # Errors
/// As for [`check_name`].
pub(crate) fn check_prose(text: &str) -> Result<(), String> {
    check_length(text, LONGEST_PROSE)?;
    check_start(text)?;
    match text
        .chars()
        .find(|c| c.is_control() || "<>".contains(*c) || is_invisible(*c))
    {
        Some(odd) => Err(format!(
            "has the character {odd:?}; leave out markup, line breaks and control characters"
        )),
        None => Ok(()),
    }
}

/// Checks a sentence that `bench` wrote down during a run: it may say `<` and is escaped wherever it
/// is shown.
///
/// # Errors
/// As for [`check_name`].
pub(crate) fn check_sentence(text: &str) -> Result<(), String> {
    check_length(text, 4 * LONGEST_PROSE)?;
    match text
        .chars()
        .find(|c| (c.is_control() && *c != '\n') || is_invisible(*c))
    {
        Some(odd) => Err(format!("has the character {odd:?}")),
        None => Ok(()),
    }
}

/// Checks an image's id: parts of letters, digits and `-_.`, divided by `/`, none of them a way up.
///
/// # Errors
/// As for [`check_name`].
pub(crate) fn check_id(text: &str) -> Result<(), String> {
    check_length(text, LONGEST_ID)?;
    let is_way = |part: &str| part.is_empty() || part.chars().all(|c| c == '.');
    if text.split('/').any(is_way) {
        return Err("leads out of its folder; ids are names divided by single slashes".to_owned());
    }
    let odd = |c: &char| !(c.is_ascii_alphanumeric() || "-_./".contains(*c));
    match text.chars().find(odd) {
        Some(odd) => Err(format!(
            "has the character {odd:?}; ids may have letters, digits and -_./"
        )),
        None => check_start(text),
    }
}

/// Checks the name of a submission's folder, which is part of its addresses too.
///
/// # Errors
/// As for [`check_name`].
pub(crate) fn check_folder(text: &str) -> Result<(), String> {
    check_length(text, LONGEST_FOLDER)?;
    let odd = |c: &char| !(c.is_ascii_alphanumeric() || "-_.".contains(*c));
    if let Some(odd) = text.chars().find(odd) {
        return Err(format!(
            "has the character {odd:?}; folders may have letters, digits and -_."
        ));
    }
    if !text.starts_with(|c: char| c.is_ascii_alphanumeric()) || text.ends_with('.') {
        return Err("must begin with a letter or digit and not end with a point".to_owned());
    }
    Ok(())
}

/// Checks a BLAKE3 digest in hex.
///
/// # Errors
/// As for [`check_name`].
pub(crate) fn check_digest(text: &str) -> Result<(), String> {
    let is_hex = |b: u8| b.is_ascii_digit() || (b'a'..=b'f').contains(&b);
    if text.len() == 64 && text.bytes().all(is_hex) {
        return Ok(());
    }
    Err("is not a digest of 64 hexadecimal digits".to_owned())
}

fn check_length(text: &str, longest: usize) -> Result<(), String> {
    match text.chars().count() {
        0 => Err("is empty".to_owned()),
        count if count > longest => Err(format!(
            "has {count} letters; at most {longest} may stand here"
        )),
        _ if text.trim() != text => Err("begins or ends with a space".to_owned()),
        _ => Ok(()),
    }
}

fn check_start(text: &str) -> Result<(), String> {
    match text.chars().next() {
        Some(first) if "=+-@'".contains(first) => Err(format!(
            "begins with {first:?}, which a spreadsheet takes for a formula; begin with a letter or digit"
        )),
        _ => Ok(()),
    }
}

/// Characters that change the order or are not seen: what is read would not be what is there.
fn is_invisible(c: char) -> bool {
    matches!(c, '\u{200b}'..='\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2060}'..='\u{2069}' | '\u{feff}')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_of_strangers_are_names_or_refused() {
        for name in [
            "StrAT",
            "Median depth (constant)",
            "strat@2",
            "Méthode 3, v1.0",
            "深度",
        ] {
            assert_eq!(check_name(name), Ok(()), "{name}");
        }
        for (name, why) in [
            ("=cmd|' /C calc'!A0", "spreadsheet"),
            ("@SUM(A1)", "spreadsheet"),
            ("<script>alert(1)</script>", "'<'"),
            ("a\"onload=\"x", "'\"'"),
            ("a\u{202e}b", "202e"),
            ("a\tb", "\\t"),
            ("", "is empty"),
            (" a", "space"),
        ] {
            let told = check_name(name).unwrap_err();
            assert!(told.contains(why), "{name}: {told}");
        }
        assert!(check_name(&"a".repeat(81)).is_err());
        assert!(check_prose("Trained on: 23,158 pairs (Eigen), see doi 10.1/2").is_ok());
        assert!(check_prose("a <b>").is_err() && check_prose("a\nb").is_err());
    }

    #[test]
    fn ids_and_folders_stay_where_they_are() {
        for id in [
            "2011_09_26_drive_0001/0000000005",
            "test/img-op57-p-016t000",
            "x",
        ] {
            assert_eq!(check_id(id), Ok(()), "{id}");
        }
        for id in [
            "../../etc/passwd",
            "/etc/passwd",
            "a//b",
            "a/./b",
            "a\\b",
            "a b",
            "-x",
        ] {
            assert!(check_id(id).is_err(), "{id}");
        }
        for folder in ["strat-small", "a.b_c", "7"] {
            assert_eq!(check_folder(folder), Ok(()), "{folder}");
        }
        for folder in ["..", ".git", "a/b", "-x", "a.", "ä", "a b", "<b>"] {
            assert!(check_folder(folder).is_err(), "{folder}");
        }
        assert!(check_digest(&"0f".repeat(32)).is_ok() && check_digest("0F").is_err());
    }
}
