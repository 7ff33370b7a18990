//! A protocol applied to one image: choose the pixels, align, clip, measure.

use std::ops::Range;

use super::alignment::{Aligned, Fit};
use super::error::EvaluateError;
use super::pixels::Pixels;
use super::scene::Scene;
use super::scratch::{Finder, Scratch};
use super::tallies::{GroupTally, Tallies};
use crate::metrics::{FurtherMetrics, Metrics};
use crate::protocol::{Alignment, Group, Grouping, LogBase};
use crate::sums::AT_A_TIME;

/// Score of one image, or of one group of pixels in it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImageScore {
    /// The group, for protocols with groups.
    pub group: Option<Group>,
    /// The seven metrics.
    pub metrics: Metrics,
    /// The metrics of PROTOCOL 10.3, where they were asked for.
    pub further: Option<FurtherMetrics>,
    /// D1-all in percent, where the protocol asks for it and the ground truth is disparity.
    pub d1_all: Option<f64>,
    /// Sum of squared errors in m^2, from which pooled errors are made.
    pub sum_squared_error: f64,
    /// Pixels scored; never 0.
    pub pixels: u64,
    /// Pixels without a usable prediction: disparity that was raised to the floor and is scored
    /// there, or no depth at all, which is in none of the figures and not among `pixels`.
    pub floored_pixels: u64,
    /// The numbers by which the image was aligned with its truth, under protocols that align.
    pub fit: Option<Fit>,
}

/// What one prediction was compared with, and how: what a picture of its error must show.
#[derive(Clone, Debug, PartialEq)]
pub struct Compared {
    /// Columns of the ground truth.
    pub width: usize,
    /// Rows of the ground truth.
    pub height: usize,
    /// The numbers by which the prediction was aligned; none without alignment.
    pub fit: Option<Fit>,
    /// Aligned depth was clipped to this, in metres.
    pub limits_m: (f64, f64),
    /// The scored pixels, row by row; under a protocol with groups those of any group.
    pub pixels: Vec<ComparedPixel>,
    /// The whole prediction as depth in metres, aligned and clipped like the scored pixels; 0 where
    /// it has none.
    pub predicted_m: Vec<f32>,
}

/// A scored pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ComparedPixel {
    /// Row-major position within the ground truth.
    pub index: usize,
    /// True depth in metres.
    pub truth_m: f64,
    /// Predicted depth in metres, aligned and clipped.
    pub predicted_m: f64,
}

/// Scores with the pixels behind them.
pub(super) struct Scored {
    pub(super) scores: Vec<ImageScore>,
    pixels: Pixels,
    aligned: Aligned,
}

impl Scored {
    /// The scores, and what was compared, of a prediction for all pixels.
    pub(super) fn with_pixels(self, scene: &Scene<'_>) -> (Vec<ImageScore>, Compared) {
        let is_grouped = scene.protocol.grouping != Grouping::None;
        let of_pixel = |at: usize| ComparedPixel {
            index: scene.truth.measured[self.pixels.places[at] as usize] as usize,
            truth_m: self.pixels.truth_m[at],
            predicted_m: scene.scored_m(self.pixels.values[at], self.aligned),
        };
        let is_scored = |&at: &usize| !is_grouped || self.pixels.groups[at].is_some();
        let pixels = (0..self.pixels.places.len())
            .filter(is_scored)
            .map(of_pixel);
        let whole = 0..scene.truth.width * scene.truth.height;
        let predicted_m = whole.map(|index| {
            let predicted = scene.predicted(index).filter(|_| scene.is_shown(index));
            predicted.map_or(0.0, |predicted| {
                scene.scored_m(predicted.value, self.aligned) as f32
            })
        });
        let compared = Compared {
            width: scene.truth.width,
            height: scene.truth.height,
            fit: self.aligned.fit,
            limits_m: (f64::from(scene.min_depth_m), f64::from(scene.max_depth_m)),
            pixels: pixels.collect(),
            predicted_m: predicted_m.collect(),
        };
        (self.scores, compared)
    }
}

impl Scene<'_> {
    /// Adds pixels to what is known of their groups.
    fn add<const FURTHER: bool>(
        &self,
        pixels: &Pixels,
        aligned: Aligned,
        finder: &mut Finder<'_>,
        tallies: &mut Tallies,
    ) {
        let count = pixels.places.len();
        for start in (0..count).step_by(AT_A_TIME) {
            let some = start..count.min(start + AT_A_TIME);
            self.add_some::<FURTHER>(pixels, some, aligned, finder, tallies);
        }
    }

    /// Adds some of the pixels, at most [`AT_A_TIME`], to what is known of their groups.
    fn add_some<const FURTHER: bool>(
        &self,
        pixels: &Pixels,
        some: Range<usize>,
        aligned: Aligned,
        finder: &mut Finder<'_>,
        tallies: &mut Tallies,
    ) {
        let strict = self.protocol.strict_comparisons;
        let places = &pixels.places[some.clone()];
        let mut predicted_m = [0.0; AT_A_TIME];
        let predicted_m = &mut predicted_m[..places.len()];
        for (predicted_m, value) in predicted_m.iter_mut().zip(&pixels.values[some.clone()]) {
            *predicted_m = self.scored_m(*value, aligned);
        }
        let terms = finder.terms(places, &pixels.truth_m[some.clone()], predicted_m);
        let floored = &pixels.floored[some.clone()];
        // Aligned depth no longer belongs to the disparity it was made of.
        let rule = self.protocol.d1_rule.filter(|_| aligned.fit.is_none());
        let true_px = rule.zip(self.truth.disparity_px.as_ref());
        let disparities = true_px.map(|(rule, true_px)| {
            let predicted_px = &pixels.disparities_px[some.clone()];
            let true_px = places.iter().map(|place| true_px[*place as usize]);
            (rule, true_px.zip(predicted_px))
        });
        if let [(None, all)] = tallies.groups.as_mut_slice() {
            all.sums.add_all::<FURTHER>(terms, strict);
            all.floored += floored
                .iter()
                .map(|floored| u64::from(*floored))
                .sum::<u64>();
            if let Some((rule, disparities)) = disparities {
                for (true_px, predicted_px) in disparities {
                    all.disparities.add(true_px, *predicted_px, rule);
                }
            }
            return;
        }
        let groups = &pixels.groups[some];
        for ((group, terms), floored) in groups.iter().zip(terms).zip(floored) {
            if let Some(own) = tallies.of(*group) {
                own.sums.add::<FURTHER>(terms, strict);
                own.floored += u64::from(*floored);
            }
        }
        if let Some((rule, disparities)) = disparities {
            for (group, (true_px, predicted_px)) in groups.iter().zip(disparities) {
                if let Some(own) = tallies.of(*group) {
                    own.disparities.add(true_px, *predicted_px, rule);
                }
            }
        }
    }

    /// Scores, and the pixels behind them if they are to be `kept`.
    pub(super) fn score(
        &self,
        further: bool,
        scratch: &mut Scratch,
        kept: bool,
    ) -> Result<Scored, EvaluateError> {
        match further {
            true => self.score_with::<true>(scratch, kept),
            false => self.score_with::<false>(scratch, kept),
        }
    }

    fn score_with<const FURTHER: bool>(
        &self,
        scratch: &mut Scratch,
        kept: bool,
    ) -> Result<Scored, EvaluateError> {
        let (protocol, truth) = (self.protocol, self.truth);
        let mut tallies = Tallies::new(protocol.grouping);
        let is_grouped = protocol.grouping != Grouping::None;
        let mut pixels = Pixels::default();
        let mut finder = scratch.begin(truth.measured.len());
        let aligned = if protocol.alignment == Alignment::None {
            // Nothing has to be known of the other pixels.
            let aligned = Aligned::NOT;
            let mut some = Pixels::default();
            some.reserve(AT_A_TIME + truth.width, is_grouped);
            let mut add = |some: &mut Pixels, tallies: &mut Tallies| {
                self.add::<FURTHER>(some, aligned, &mut finder, tallies);
                if kept {
                    pixels.append(some);
                }
                some.truncate(0);
            };
            self.visit(&mut some, &mut tallies, &mut add);
            add(&mut some, &mut tallies);
            aligned
        } else {
            pixels.reserve(truth.measured.len(), is_grouped);
            self.visit(&mut pixels, &mut tallies, |_, _| ());
            let pairs = pixels
                .values
                .iter()
                .copied()
                .zip(pixels.truth_m.iter().copied());
            let aligned = Aligned::of_pairs(protocol.alignment, pairs)?;
            if protocol.alignment.is_of_inverse_depth() {
                for (floored, value) in pixels.floored.iter_mut().zip(&pixels.values) {
                    *floored = aligned.is_floored(*value);
                }
            }
            self.add::<FURTHER>(&pixels, aligned, &mut finder, &mut tallies);
            aligned
        };
        let scores: Vec<ImageScore> = tallies
            .groups
            .iter()
            .filter_map(|(group, tally)| self.summarise::<FURTHER>(*group, tally, aligned))
            .collect();
        if scores.is_empty() && tallies.unpredicted > 0 {
            return Err(EvaluateError::NothingPredicted {
                pixels: tallies.unpredicted,
            });
        }
        if scores.is_empty() {
            return Err(EvaluateError::NothingToScore {
                name: protocol.name.clone(),
                with_truth: truth.depth_m.iter().filter(|&&depth| depth > 0.0).count(),
            });
        }
        Ok(Scored {
            scores,
            pixels,
            aligned,
        })
    }

    /// A prediction as it is compared: aligned, then clipped.
    #[inline]
    fn scored_m(&self, value: f64, aligned: Aligned) -> f64 {
        let depth_m = aligned.depth_m(value);
        depth_m.clamp(f64::from(self.min_depth_m), f64::from(self.max_depth_m))
    }

    /// `None` without pixels.
    fn summarise<const FURTHER: bool>(
        &self,
        group: Option<Group>,
        tally: &GroupTally,
        aligned: Aligned,
    ) -> Option<ImageScore> {
        let mut metrics = tally.sums.metrics()?;
        if self.protocol.log_base == LogBase::Ten {
            metrics.rmse_log /= std::f64::consts::LN_10;
        }
        Some(ImageScore {
            group,
            metrics,
            further: tally.sums.further_metrics().filter(|_| FURTHER),
            d1_all: tally.disparities.percentage(),
            sum_squared_error: tally.sums.sum_squared_error(),
            pixels: tally.sums.count(),
            floored_pixels: tally.floored,
            fit: aligned.fit,
        })
    }
}
