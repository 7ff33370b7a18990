//! The answer of a study, from rows alone: means and spread of the variants, differences, and a sentence
//! for each pair.
//!
//! The statistics are [`strat_metrics::study`]'s; here are its text and tables. Not here: how rows are
//! measured, see [`crate::study`].

use strat_metrics::{
    CsvError, Metric, Row,
    study::{self, Certainty, Difference, Needed, Part, Study, StudyError, Variant, Verdict},
};

use super::compare::{p_text, protocols_of};

/// The difference that a study says the cost of, unless it is given: about what the thesis' steps are
/// in Abs Rel.
pub const EFFECT: f64 = 0.01;

/// Studies under all protocols among the rows, in the order of their first row.
///
/// # Errors
/// Rows that do not belong together.
pub fn studies(rows: &[Row], effect: f64) -> Result<Vec<Study>, StudyError> {
    let protocols = protocols_of(rows);
    let found = protocols
        .iter()
        .map(|name| study::study(rows, name, effect));
    Ok(found
        .collect::<Result<Vec<_>, _>>()?
        .into_iter()
        .flatten()
        .collect())
}

/// Whether some pair of variants can be compared at all.
#[must_use]
pub fn has_pairs(studies: &[Study]) -> bool {
    let mut parts = studies.iter().flat_map(|study| &study.parts);
    parts.any(|part| !part.differences.is_empty())
}

/// Means and deviations of all variants, as CSV with exact numbers: a line for each variant, protocol
/// and group.
///
/// # Errors
/// The CSV writer's own; none in practice.
pub fn variants_csv(studies: &[Study]) -> Result<Vec<u8>, CsvError> {
    let mut csv = strat_csv::Writer::new(Vec::new());
    let mut header: Vec<String> = ["protocol", "group", "variant", "seeds", "images", "drives"]
        .map(str::to_owned)
        .into();
    for metric in Metric::ALL {
        header.extend([
            metric.name().to_owned(),
            format!("{}_deviation", metric.name()),
        ]);
    }
    csv.write_record(&header)?;
    for (study, part) in parts(studies) {
        for variant in &part.variants {
            let mut line = begin(study, part);
            line.extend([
                variant.name.clone(),
                variant.seeds.len().to_string(),
                part.images.to_string(),
                part.clusters.total().to_string(),
            ]);
            for index in 0..Metric::ALL.len() {
                let deviation = variant.deviation.map(|all| all[index].to_string());
                line.extend([
                    variant.mean[index].to_string(),
                    deviation.unwrap_or_default(),
                ]);
            }
            csv.write_record(&line)?;
        }
    }
    Ok(csv.into_inner()?)
}

const DIFFERENCES: [&str; 27] = [
    "protocol",
    "group",
    "metric",
    "first",
    "second",
    "seeds_first",
    "seeds_second",
    "images",
    "drives",
    "mean_first",
    "mean_second",
    "difference",
    "low",
    "high",
    "standard_error",
    "degrees",
    "p",
    "p_holm",
    "family",
    "second_is",
    "share_of_seeds",
    "share_of_drives",
    "effect",
    "seeds_needed",
    "drives_needed",
    "seeds_and_drives_needed",
    "unknown",
];

/// Every pair of variants in every metric, as CSV with exact numbers.
///
/// # Errors
/// The CSV writer's own; none in practice.
pub fn differences_csv(studies: &[Study]) -> Result<Vec<u8>, CsvError> {
    let mut csv = strat_csv::Writer::new(Vec::new());
    csv.write_record(DIFFERENCES)?;
    for (study, part) in parts(studies) {
        for one in &part.differences {
            let known = one.certainty.as_ref().ok();
            let number = |value: fn(&Certainty) -> f64| {
                known
                    .map(|known| value(known).to_string())
                    .unwrap_or_default()
            };
            let count = |value: fn(&Needed) -> Option<u32>| {
                let count = known.and_then(|known| value(&known.needed));
                count.map(|count| count.to_string()).unwrap_or_default()
            };
            let mut line = begin(study, part);
            line.extend([
                one.metric.name().to_owned(),
                one.first.clone(),
                one.second.clone(),
                one.seeds[0].to_string(),
                one.seeds[1].to_string(),
                part.images.to_string(),
                part.clusters.total().to_string(),
                one.means[0].to_string(),
                one.means[1].to_string(),
                one.difference.to_string(),
                number(|known| known.interval.low),
                number(|known| known.interval.high),
                number(|known| known.error),
                number(|known| known.degrees),
                number(|known| known.p),
                number(|known| known.p_holm),
                known
                    .map(|known| known.family.to_string())
                    .unwrap_or_default(),
                verdict_words(one.verdict()).to_owned(),
                number(|known| known.of_seeds),
                number(|known| known.of_drives),
                study.effect.to_string(),
                count(|needed| needed.seeds),
                count(|needed| needed.drives),
                known
                    .and_then(|known| known.needed.both)
                    .map(|(seeds, drives)| format!("{seeds} and {drives}"))
                    .unwrap_or_default(),
                one.certainty
                    .as_ref()
                    .err()
                    .map(ToString::to_string)
                    .unwrap_or_default(),
            ]);
            csv.write_record(&line)?;
        }
    }
    Ok(csv.into_inner()?)
}

fn parts(studies: &[Study]) -> impl Iterator<Item = (&Study, &Part)> {
    studies
        .iter()
        .flat_map(|study| study.parts.iter().map(move |part| (study, part)))
}

fn begin(study: &Study, part: &Part) -> Vec<String> {
    let group = part.group.map(|group| group.to_string());
    vec![study.protocol.clone(), group.unwrap_or_default()]
}

/// The answer in words: for each protocol the variants in one metric, then a sentence for each pair.
#[must_use]
pub fn answer(studies: &[Study], metric: Metric) -> String {
    let mut text = String::new();
    for (study, part) in parts(studies) {
        text += &part_text(study, part, metric);
        text.push('\n');
    }
    let Some(effect) = studies.first().map(|study| study.effect) else {
        return text;
    };
    text + &format!(
        "Differences are those of the variant named first to the other, with 95 % intervals over the choice of seeds and of drives \
         (PROTOCOL 11.1). Better and worse: p below {} after Holm over all pairs in this metric. Needed: \
         what finds a difference of {effect} in four of five studies like this, one pair at a time.\n",
        study::LEVEL
    )
}

fn part_text(study: &Study, part: &Part, metric: Metric) -> String {
    let group = part
        .group
        .map_or(String::new(), |group| format!(", {group}"));
    let mut text = format!(
        "{} under {}{group}: {} of {}\n",
        metric.heading(),
        study.protocol,
        counted(part.images, "image"),
        recordings(part),
    );
    let longest = part.variants.iter().map(|v| v.name.chars().count()).max();
    let longest = longest.unwrap_or(0);
    for variant in &part.variants {
        text += &format!(
            "  {:longest$}  {}\n",
            variant.name,
            described(variant, metric)
        );
    }
    if !part.lacking.is_empty() {
        let lacking = part.lacking.iter();
        let lacking: Vec<String> = lacking
            .map(|(model, images)| format!("{model} lacks {images}"))
            .collect();
        text += &format!(
            "Only images that all have are counted; {}.\n",
            lacking.join(", ")
        );
    }
    for sentence in sentences(study, part, metric) {
        text += &sentence;
        text.push('\n');
    }
    text
}

/// What a verdict is called in tables.
#[must_use]
pub fn verdict_words(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::Better => "better",
        Verdict::Worse => "worse",
        Verdict::Open => "not told apart",
    }
}

fn described(variant: &Variant, metric: Metric) -> String {
    let index = metric as usize;
    let mean = variant.mean[index];
    match (variant.deviation, variant.seeds.len()) {
        (Some(deviation), seeds) => format!("{mean:.4} ± {:.4}  {seeds} seeds", deviation[index]),
        (None, 0) => format!("{mean:.4}           one model, no seeds"),
        (None, _) => format!("{mean:.4}           1 seed"),
    }
}

/// A sentence for each pair of variants in one metric.
#[must_use]
pub fn sentences(study: &Study, part: &Part, metric: Metric) -> Vec<String> {
    let own = part.differences.iter().filter(|one| one.metric == metric);
    own.map(|one| sentence(one, part, study.effect)).collect()
}

/// One sentence about a pair, and what it would take.
fn sentence(one: &Difference, part: &Part, effect: f64) -> String {
    let Difference {
        first,
        second,
        difference,
        means,
        metric,
        ..
    } = one;
    let known = match &one.certainty {
        Ok(known) => known,
        Err(reason) => {
            return format!(
                "{second} and {first}: {} {:.4} and {:.4}; whether they differ cannot be said: {reason}.",
                metric.heading(),
                means[1],
                means[0],
            );
        }
    };
    let verdict = match one.verdict() {
        Verdict::Better => format!("{second} is better than {first}"),
        Verdict::Worse => format!("{second} is worse than {first}"),
        Verdict::Open => format!("{second} and {first} are not told apart"),
    };
    let pairs = match known.family {
        1 => String::new(),
        family => format!(" after Holm over {family} pairs"),
    };
    format!(
        "{verdict}: {:.4} against {:.4}, difference {difference:+.4} (95 % {:+.4} to {:+.4}; p {}{pairs}). {}",
        means[1],
        means[0],
        known.interval.low,
        known.interval.high,
        p_text(Some(known.p_holm)),
        needed(one, known, part, effect),
    )
}

/// What it would take to see a difference of the effect.
fn needed(one: &Difference, known: &Certainty, part: &Part, effect: f64) -> String {
    let Needed {
        enough,
        seeds,
        drives,
        both,
    } = known.needed;
    let unit = if part.clusters.drives > 0 {
        "drive"
    } else {
        "recording"
    };
    let now = format!("these {}", counted(part.clusters.total(), unit));
    if enough {
        return format!("Seeds and drives suffice to find {effect}.");
    }
    let with_seeds = |seeds: u32| format!("{} of each on {now}", counted(u64::from(seeds), "seed"));
    let with_drives = |drives: u32| {
        let these = if one.seeds == [0, 0] {
            ""
        } else {
            " with these seeds"
        };
        format!("{}{these}", counted(u64::from(drives), unit))
    };
    let way = match (seeds, drives, both) {
        (Some(seeds), Some(drives), _) => {
            format!("{}, or {}", with_seeds(seeds), with_drives(drives))
        }
        (Some(seeds), None, _) => format!("{}; no more drives alone", with_seeds(seeds)),
        (None, Some(drives), _) => format!("{}; no more seeds alone", with_drives(drives)),
        (None, None, Some((seeds, drives))) => format!(
            "{} of each on {} together, neither alone",
            counted(u64::from(seeds), "seed"),
            counted(u64::from(drives), unit)
        ),
        (None, None, None) => "no number of seeds and drives tried was enough".to_owned(),
    };
    format!("To find {effect}: {way}.")
}

fn recordings(part: &Part) -> String {
    part.clusters.to_string()
}

fn counted(count: u64, what: &str) -> String {
    format!("{count} {what}{}", if count == 1 { "" } else { "s" })
}

#[cfg(test)]
mod tests {
    use strat_metrics::{ImageScore, Metrics, RowContext};

    use super::*;

    /// Rows of seeds of a variant over two images of each of ten drives. What a seed and what a drive do is
    /// a fixed number of the given size.
    fn rows(variant: &str, seeds: u32, abs_rel: f64, of_seeds: f64, of_drives: f64) -> Vec<Row> {
        let mut rows = Vec::new();
        for seed in 1..=seeds {
            let context = RowContext {
                model: format!("{variant}@{seed}"),
                model_hash: format!("{variant}{seed}"),
                protocol: "eigen-80".to_owned(),
                protocol_digest: "digest".to_owned(),
                data_digest: "digest".to_owned(),
                ..RowContext::default()
            };
            for image in 0..20 {
                let drive = image / 2;
                let shift = variant.len() as u32 + drive;
                let metrics = Metrics {
                    abs_rel: abs_rel
                        + of_seeds * f64::from(seed * 2 % 5)
                        + of_drives * f64::from(shift * 3 % 7),
                    ..Metrics::default()
                };
                let score = ImageScore {
                    group: None,
                    metrics,
                    further: None,
                    d1_all: None,
                    sum_squared_error: 1.0,
                    pixels: 1,
                    floored_pixels: 0,
                    fit: None,
                };
                let image = format!("2011_09_26_drive_{drive:04}/{image:010}");
                rows.push(Row::new(&context, image, score));
            }
        }
        rows
    }

    fn answer_of(rows: &[Row]) -> String {
        answer(&studies(rows, EFFECT).unwrap(), Metric::AbsRel)
    }

    #[test]
    fn the_better_variant_is_named_with_its_numbers() {
        let all = [
            rows("no-adv", 5, 0.2, 0.001, 0.001),
            rows("strat", 5, 0.1, 0.001, 0.001),
        ]
        .concat();
        let text = answer_of(&all);
        assert!(
            text.contains("Abs Rel under eigen-80: 20 images of 10 drives\n"),
            "{text}"
        );
        assert!(text.contains("strat is better than no-adv: "), "{text}");
        assert!(text.contains("p <0.0001)"), "{text}");
        assert!(
            text.contains("Seeds and drives suffice to find 0.01."),
            "{text}"
        );
        // An accuracy is better where it is higher.
        let mut turned = all.clone();
        for row in &mut turned {
            row.score.metrics.a1 = row.score.metrics.abs_rel;
        }
        let text = answer(&studies(&turned, EFFECT).unwrap(), Metric::A1);
        assert!(text.contains("strat is worse than no-adv"), "{text}");
    }

    #[test]
    fn what_is_not_told_apart_says_what_it_takes() {
        let of = |seeds: f64, drives: f64| {
            answer_of(
                &[
                    rows("no-adv", 5, 0.2, seeds, drives),
                    rows("strat", 5, 0.19, seeds, drives),
                ]
                .concat(),
            )
        };
        let text = of(0.02, 0.0001);
        assert!(
            text.contains("strat and no-adv are not told apart: "),
            "{text}"
        );
        assert!(
            text.contains(" of each on these 10 drives; no more drives alone."),
            "{text}"
        );
        let text = of(0.0001, 0.02);
        assert!(
            text.contains("drives with these seeds; no more seeds alone."),
            "{text}"
        );
        let text = of(0.02, 0.02);
        assert!(text.contains("together, neither alone."), "{text}");
    }

    #[test]
    fn one_seed_is_not_enough_and_says_so() {
        let all = [rows("a", 1, 0.2, 0.01, 0.01), rows("b", 3, 0.2, 0.01, 0.01)].concat();
        let text = answer_of(&all);
        assert!(
            text.contains("cannot be said: the spread between seeds takes at least 2"),
            "{text}"
        );
        assert!(text.contains("1 seed\n"), "{text}");
        let csv =
            String::from_utf8(differences_csv(&studies(&all, EFFECT).unwrap()).unwrap()).unwrap();
        assert_eq!(csv.lines().count(), 1 + 7);
        assert!(
            csv.lines().nth(1).unwrap().contains(",not told apart,"),
            "{csv}"
        );
        let csv =
            String::from_utf8(variants_csv(&studies(&all, EFFECT).unwrap()).unwrap()).unwrap();
        assert_eq!(csv.lines().count(), 1 + 2);
    }
}
