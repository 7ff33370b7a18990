//! Sizes, durations, counts and lists as people read them.

/// `999 bytes`, `1.4 kB`, `15.2 GB`: powers of ten, as disks are sold.
pub fn bytes(bytes: u64) -> String {
    if bytes < 1000 {
        return format!("{bytes} bytes");
    }
    let mut size = bytes as f64 / 1000.0;
    for unit in ["kB", "MB", "GB"] {
        if size < 999.95 {
            return format!("{size:.1} {unit}");
        }
        size /= 1000.0;
    }
    format!("{size:.1} TB")
}

/// `8 s`, `3 min 20 s`, `12 min`, `2 h 5 min`, `31 h`: two units while the smaller one matters.
/// What is negative or not a number counts as nothing.
pub fn duration(seconds: f64) -> String {
    let seconds = seconds.round() as u64;
    // Rounded to what is shown, so that 599.6 s are not "9 min 60 s".
    let minutes = if seconds < 600 {
        seconds / 60
    } else {
        (seconds + 30) / 60
    };
    let hours = if minutes < 600 {
        minutes / 60
    } else {
        (minutes + 30) / 60
    };
    match (hours, minutes % 60, seconds % 60) {
        (0, 0, s) => format!("{s} s"),
        (0, m, s) if m < 10 && s > 0 => format!("{m} min {s} s"),
        (0, m, _) => format!("{m} min"),
        (h, m, _) if h < 10 && m > 0 => format!("{h} h {m} min"),
        (h, _, _) => format!("{h} h"),
    }
}

/// `1 image`, `3 images`.
pub fn count(number: usize, one: &str, many: &str) -> String {
    format!("{number} {}", if number == 1 { one } else { many })
}

/// `a, b, c, ...`: up to three names, and whether there are more; none for no names.
pub fn first_three(names: &[String]) -> Option<String> {
    let more = if names.len() > 3 { ", ..." } else { "" };
    let shown: Vec<&str> = names.iter().take(3).map(String::as_str).collect();
    (!names.is_empty()).then(|| format!("{}{more}", shown.join(", ")))
}

/// The one of `known` that looks like a mistyped `word`.
pub fn closest<'a>(word: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let rated = known
        .into_iter()
        .map(|other| (strsim::damerau_levenshtein(word, other), other));
    let (distance, best) = rated.min_by_key(|(distance, _)| *distance)?;
    (3 * distance <= word.len().max(3)).then_some(best)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_readable() {
        for (size, text) in [
            (0, "0 bytes"),
            (999, "999 bytes"),
            (1_400, "1.4 kB"),
            (999_990, "1.0 MB"),
            (15_250_000_000, "15.2 GB"),
            (2_000_000_000_000, "2.0 TB"),
            (u64::MAX, "18446744.1 TB"),
        ] {
            assert_eq!(bytes(size), text);
        }
    }

    #[test]
    fn lists_are_short() {
        let names = |count: usize| (0..count).map(|n| n.to_string()).collect::<Vec<_>>();
        assert_eq!(first_three(&names(0)), None);
        assert_eq!(first_three(&names(3)).unwrap(), "0, 1, 2");
        assert_eq!(first_three(&names(4)).unwrap(), "0, 1, 2, ...");
        assert_eq!(count(1, "image", "images"), "1 image");
        assert_eq!(count(0, "image", "images"), "0 images");
    }

    #[test]
    fn mistyped_words_are_recognised() {
        let known = ["epochs", "learning_rate", "batch"];
        assert_eq!(closest("epoch", known), Some("epochs"));
        assert_eq!(closest("lerning_rate", known), Some("learning_rate"));
        assert_eq!(closest("zebra", known), None);
    }

    #[test]
    fn durations_are_readable() {
        for (seconds, text) in [
            (f64::NAN, "0 s"),
            (-3.0, "0 s"),
            (7.6, "8 s"),
            (59.6, "1 min"),
            (200.0, "3 min 20 s"),
            (599.6, "10 min"),
            (725.0, "12 min"),
            (3_599.0, "1 h"),
            (7_500.0, "2 h 5 min"),
            (35_990.0, "10 h"),
            (111_600.0, "31 h"),
        ] {
            assert_eq!(duration(seconds), text, "{seconds}");
        }
    }
}
