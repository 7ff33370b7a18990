//! What the first images of a run say about the description, before hours are spent on the others.
//!
//! Numbers that are another thing than they are said to be leave a trace beside the truth: near and far
//! exchanged, a factor that has a name, a scale of their own in each image, a map that fits better when it is
//! turned, a sky that is nearest. Each becomes a warning with its likely cause and the line of the
//! description to change; nothing is ever corrected. Not here: the agreement over all images
//! ([`super::agreement`]), and what cannot be at all ([`crate::model::plausible`]).

use strat_metrics::{GroundTruth, Protocol};
use strat_onnx::metadata::OutputMeaning;

use super::agreement::{self, Agreement, ImageAgreement, spearman};
use crate::model::ValueEncoding;

/// Images after which it is said.
pub const FIRST_IMAGES: usize = 8;

/// Rank correlation below which near and far are exchanged.
const REVERSED: f64 = -0.2;

/// Rank correlation that a turned map must have before it is spoken of.
const FITS: f64 = 0.6;

/// How much more a turned map must correlate, in the mean; and it must in each image.
const GAIN: f64 = 0.03;

/// How far off a factor with a name may be.
const NAMED: f64 = 0.15;

/// Share of rows, from the top, that are sky where nothing was measured in them.
const SKY_ROWS: f64 = 0.1;

/// Ways to turn a map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Turn {
    Mirrored,
    UpsideDown,
    Transposed,
}

impl Turn {
    const ALL: [Self; 3] = [Self::Mirrored, Self::UpsideDown, Self::Transposed];

    /// Where the value for a pixel of the truth lies, if the map is turned so.
    fn index(self, index: usize, width: usize, height: usize) -> usize {
        let (row, column) = (index / width, index % width);
        let (row, column) = match self {
            Self::Mirrored => (row, width - 1 - column),
            Self::UpsideDown => (height - 1 - row, column),
            // Maps of any shape are brought to the image's, so rows become columns by their share.
            Self::Transposed => (column * height / width, row * width / height),
        };
        row * width + column
    }
}

/// What one image shows.
#[derive(Clone, Debug, PartialEq)]
pub struct Look {
    pub(super) agreement: ImageAgreement,
    /// Rank correlations of the map turned each way: mirrored, upside down, transposed.
    pub(super) turned: [Option<f64>; 3],
    /// Whether the uppermost rows, where nothing was measured, are nearer than nearly all that was.
    pub(super) sky_is_nearest: Option<bool>,
    /// Of the image, in pixels.
    pub(super) width: f64,
    pub(super) focal_px: f64,
}

/// Looks at a map at the size of the truth: depth, or disparity of which larger values are nearer.
pub(super) fn look(
    protocol: &Protocol,
    truth: &GroundTruth,
    map: &[f32],
    is_disparity: bool,
    agreement: ImageAgreement,
    (image_width, focal_px): (u32, f64),
) -> Look {
    let (width, height) = truth.size();
    let limits = protocol.min_depth_m as f32..=protocol.max_depth_m as f32;
    let measured = truth.measured();
    let pixels: Vec<(usize, f32)> = measured
        .iter()
        .zip(truth.depth_m())
        .step_by(agreement::stride(measured.len()))
        .map(|(&index, &true_m)| (index as usize, true_m))
        .filter(|(_, true_m)| limits.contains(true_m))
        .collect();
    // Of the order alone.
    let depth_like = |value: f32| if is_disparity { -value } else { value };
    let there = |value: f32| is_disparity || value > 0.0;
    let turned = Turn::ALL.map(|turn| {
        let pairs = pixels.iter().filter_map(|&(index, true_m)| {
            let value = map[turn.index(index, width, height)];
            there(value).then(|| (true_m, depth_like(value)))
        });
        let (true_m, predicted): (Vec<f32>, Vec<f32>) = pairs.unzip();
        spearman(&true_m, &predicted)
    });
    let sky_end = (height as f64 * SKY_ROWS).ceil() as usize * width;
    let is_sky = measured
        .first()
        .is_some_and(|&first| first as usize >= sky_end);
    let sorted = |values: &mut Vec<f32>| values.sort_unstable_by(f32::total_cmp);
    let sky_is_nearest = is_sky.then(|| {
        let values = |indices: &mut dyn Iterator<Item = usize>| -> Vec<f32> {
            let values = indices
                .map(|index| map[index])
                .filter(|value| there(*value));
            values.map(depth_like).collect()
        };
        let mut sky = values(&mut (0..sky_end));
        let mut ground = values(&mut pixels.iter().map(|(index, _)| *index));
        sorted(&mut sky);
        sorted(&mut ground);
        match (sky.get(sky.len() / 2), ground.get(ground.len() / 20)) {
            (Some(sky), Some(near)) => sky < near,
            _ => false,
        }
    });
    Look {
        agreement,
        turned,
        sky_is_nearest,
        width: f64::from(image_width),
        focal_px,
    }
}

/// What is suspected of maps of this encoding after the first images, as sentences.
#[must_use]
pub fn suspicions(looks: &[Look], encoding: &ValueEncoding) -> Vec<String> {
    let agreements: Vec<ImageAgreement> = looks.iter().map(|look| look.agreement).collect();
    let Some(agreement) = Agreement::of(&agreements) else {
        return Vec::new();
    };
    let over = format!("over the first {} images", looks.len());
    let mut found = Vec::new();
    let is_reversed = agreement
        .rank_correlation
        .is_some_and(|rank| rank < REVERSED);
    // A street that is reversed looks much like one that is upside down.
    let own = agreement.rank_correlation.unwrap_or(0.0);
    let turned = turned(looks).filter(|(_, rank)| !is_reversed || *rank > GAIN - own);
    if let Some((turn, rank)) = turned {
        let (what, remedy) = match turn {
            Turn::Mirrored => ("left to right", "save it as the image is seen"),
            Turn::UpsideDown => ("upside down", "save it with the uppermost row first"),
            Turn::Transposed => (
                "with rows and columns exchanged",
                "save it as [rows, columns], or change `layout` of the description's output",
            ),
        };
        found.push(format!(
            "the map fits the truth better {what} (rank correlation {rank:.2} instead of {own:.2} {over}): \
             {remedy}"
        ));
    } else if is_reversed {
        found.push(reversed(encoding, own, &over));
    }
    if turned.is_none() && !is_reversed {
        found.extend(scale(looks, encoding, &agreement, &over));
    }
    let skies: Vec<bool> = looks
        .iter()
        .filter_map(|look| look.sky_is_nearest)
        .collect();
    let is_upright = !is_reversed && turned.is_none();
    if is_upright && !skies.is_empty() && skies.iter().all(|is_nearest| *is_nearest) {
        found.push(format!(
            "the uppermost rows, where nothing was measured, are predicted nearer than 95 % of what was \
             {over}: a sky that is nearest; is infinity written as a small number there? Depth of none is 0 \
             with `meaning: depth_m`, and inverse depth of the sky is 0"
        ));
    }
    found
}

/// The way to turn the maps after which each fits better, and how well.
fn turned(looks: &[Look]) -> Option<(Turn, f64)> {
    let gains = Turn::ALL
        .into_iter()
        .enumerate()
        .filter_map(|(which, turn)| {
            let pairs: Option<Vec<(f64, f64)>> = looks
                .iter()
                .map(|look| Some((look.turned[which]?, look.agreement.rank_correlation?)))
                .collect();
            let pairs = pairs?;
            let mean =
                |values: &mut dyn Iterator<Item = f64>| values.sum::<f64>() / pairs.len() as f64;
            let rank = mean(&mut pairs.iter().map(|(turned, _)| *turned));
            let own = mean(&mut pairs.iter().map(|(_, own)| *own));
            let fits = pairs.iter().all(|(turned, own)| turned > own) && pairs.len() > 1;
            (fits && rank > FITS && rank - own > GAIN).then_some((turn, rank))
        });
    gains.max_by(|(_, a), (_, b)| a.total_cmp(b))
}

fn reversed(encoding: &ValueEncoding, rank: f64, over: &str) -> String {
    let meaning = encoding.meaning;
    let is_depth = matches!(
        encoding.meaning(),
        OutputMeaning::DepthM | OutputMeaning::Depth
    );
    let (large, instead) = match is_depth {
        true => ("far", "`meaning: inverse_depth`, or a disparity"),
        false => ("near", "`meaning: depth_m`, or `depth` without a unit"),
    };
    format!(
        "near and far are exchanged (rank correlation {rank:.2} {over}): `meaning: {meaning}` says that \
         {large} is large, and here it is small; write {instead}"
    )
}

/// A scale that is wrong by a factor, or is none.
fn scale(
    looks: &[Look],
    encoding: &ValueEncoding,
    agreement: &Agreement,
    over: &str,
) -> Option<String> {
    let (ratio, deviation) = (agreement.median_ratio?, agreement.median_ratio_deviation?);
    if deviation > agreement::SENSIBLE_SPREAD * ratio {
        return (agreement.rank_correlation? >= FITS).then(|| {
            format!(
                "the order of depths is right and their scale is another in each image (true/predicted \
                 median {ratio:.2} ± {deviation:.2} {over}): the numbers have no scale, though `meaning: \
                 {}`{} says so; write `meaning: {}` without `scale`",
                encoding.meaning,
                if encoding.scale.is_some() { " with `scale`" } else { "" },
                match encoding.meaning() {
                    OutputMeaning::DepthM => "depth",
                    _ => "inverse_depth",
                }
            )
        });
    }
    if agreement::SENSIBLE_RATIO.contains(&ratio) {
        return None;
    }
    let mean = |value: fn(&Look) -> f64| looks.iter().map(value).sum::<f64>() / looks.len() as f64;
    let named = [
        ("1000", 1000.0, "millimetres?"),
        (
            "256",
            256.0,
            "KITTI's 16-bit numbers? `png_divisor: 256` for PNG",
        ),
        ("100", 100.0, "centimetres?"),
        (
            "the width of the image",
            mean(|look| look.width),
            "disparity in pixels called a fraction, or a fraction called pixels?",
        ),
        (
            "the focal length in pixels",
            mean(|look| look.focal_px),
            "depth for a camera of another focal length (`canonical_focal_px`), or disparity without it?",
        ),
    ];
    let is_near = |factor: f64| factor > 0.0 && (ratio / factor).ln().abs() < NAMED;
    let (mut hints, mut exact) = (Vec::new(), None);
    for (name, factor, cause) in named {
        for (factor, side) in [(factor, "times"), (1.0 / factor, "of")] {
            if is_near(factor) {
                hints.push(match side {
                    "times" => format!("{name} times: {cause}"),
                    _ => format!("one part in {name}: {cause}"),
                });
                exact.get_or_insert(factor);
            }
        }
    }
    let now = encoding.scale.unwrap_or(1.0);
    let line = match (encoding.meaning, exact) {
        (OutputMeaning::DisparityPx, Some(_))
            if hints.iter().any(|hint| hint.contains("width")) =>
        {
            "`meaning: disparity_fraction`".to_owned()
        }
        (_, Some(factor)) => format!("`scale: {}`", rounded(now * factor)),
        (_, None) => format!("`scale: {}`", rounded(now * ratio)),
    };
    Some(format!(
        "true depth is {} times the predicted one in the median {over}{}; `scale` or `meaning` \
         may be wrong: if this is the model's unit, write {line}",
        rounded(ratio),
        match hints.is_empty() {
            true => String::new(),
            false => format!(", which is {}", hints.join(" Or ")),
        }
    ))
}

/// Three figures.
fn rounded(value: f64) -> String {
    let digits = (2.0 - value.abs().log10().floor()).clamp(0.0, 9.0) as usize;
    let text = format!("{value:.digits$}");
    match text.contains('.') {
        true => text.trim_end_matches('0').trim_end_matches('.').to_owned(),
        false => text,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn look(ratio: f64, rank: f64, turned: [f64; 3]) -> Look {
        Look {
            agreement: ImageAgreement {
                ratio: Some(ratio),
                rank_correlation: Some(rank),
            },
            turned: turned.map(Some),
            sky_is_nearest: None,
            width: 1242.0,
            focal_px: 721.5,
        }
    }

    fn said(looks: &[Look], meaning: OutputMeaning, scale: Option<f64>) -> String {
        let encoding = ValueEncoding {
            meaning,
            sigmoid: None,
            scale,
        };
        suspicions(looks, &encoding).join("\n")
    }

    #[test]
    fn good_maps_are_not_suspected() {
        let looks = vec![look(1.02, 0.95, [0.85, -0.6, 0.1]); 8];
        assert_eq!(said(&looks, OutputMeaning::DepthM, None), "");
        // A poor model is not a turned one.
        let looks = [
            look(1.1, 0.4, [0.5, -0.6, 0.1]),
            look(1.1, 0.6, [0.5, 0.0, 0.1]),
        ];
        assert_eq!(said(&looks, OutputMeaning::DepthM, None), "");
        assert_eq!(said(&[], OutputMeaning::DepthM, None), "");
    }

    #[test]
    fn factors_have_names_and_lines() {
        let with = |ratio: f64, meaning, scale| {
            said(&vec![look(ratio, 0.95, [0.8, 0.0, 0.0]); 4], meaning, scale)
        };
        use OutputMeaning::{DepthM, DisparityPx, InverseDepth};
        for (ratio, meaning, scale, words) in [
            (0.00101, DepthM, None, ["millimetres", "`scale: 0.001`"]),
            (0.0101, DepthM, None, ["centimetres", "`scale: 0.01`"]),
            (
                0.0038,
                DepthM,
                None,
                ["`png_divisor: 256`", "`scale: 0.00391`"],
            ),
            (700.0, DepthM, None, ["focal length", "`scale: 722`"]),
            (
                1.0 / 1240.0,
                DisparityPx,
                None,
                ["width", "`meaning: disparity_fraction`"],
            ),
            (2.7, InverseDepth, Some(2.0), ["2.7 times", "`scale: 5.4`"]),
        ] {
            let text = with(ratio, meaning, scale);
            for word in words {
                assert!(text.contains(word), "{ratio}: {text}");
            }
        }
    }

    #[test]
    fn a_scale_of_each_image_is_none() {
        let looks = [0.5, 1.0, 2.0, 4.0].map(|ratio| look(ratio, 0.95, [0.8, 0.0, 0.0]));
        let text = said(&looks, OutputMeaning::InverseDepth, Some(5.4));
        assert!(
            text.contains("with `scale`") && text.contains("`meaning: inverse_depth` without"),
            "{text}"
        );
        let text = said(&looks, OutputMeaning::DepthM, None);
        assert!(text.contains("`meaning: depth` without"), "{text}");
    }

    #[test]
    fn turned_and_reversed_maps_and_near_skies_are_told() {
        let mirrored = vec![look(1.0, 0.7, [0.98, -0.5, 0.1]); 3];
        assert!(said(&mirrored, OutputMeaning::DepthM, None).contains("left to right"));
        let reversed = vec![look(400.0, -0.95, [-0.9, 0.93, 0.1]); 3];
        let text = said(&reversed, OutputMeaning::DepthM, None);
        assert!(
            text.contains("`meaning: inverse_depth`") && !text.contains("scale"),
            "{text}"
        );
        let text = said(&reversed, OutputMeaning::DisparityFraction, None);
        assert!(text.contains("`meaning: depth_m`"), "{text}");
        let sky = Look {
            sky_is_nearest: Some(true),
            ..look(1.0, 0.95, [0.8, 0.0, 0.0])
        };
        assert!(said(&[sky.clone(), sky], OutputMeaning::DepthM, None).contains("sky"));
    }

    #[test]
    fn turns_find_their_pixels() {
        // Row 1, column 3 of 4 x 2.
        assert_eq!(Turn::Mirrored.index(7, 4, 2), 4);
        assert_eq!(Turn::UpsideDown.index(7, 4, 2), 3);
        assert_eq!(Turn::Transposed.index(7, 4, 2), 4 + 2);
    }
}
