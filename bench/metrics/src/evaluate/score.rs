//! A protocol applied to one image: choose the pixels, align, clip, measure.

use super::alignment::{Aligned, Fit};
use super::error::EvaluateError;
use super::prediction::Prediction;
use super::scene::{Places, Predicted, Scene};
use super::scratch::{Finder, Scratch};
use super::tallies::{GroupTally, Tallies};
use crate::metrics::{FurtherMetrics, Metrics};
use crate::protocol::{Alignment, Group, Grouping, LogBase};

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
    pixels: Vec<Pixel>,
    aligned: Aligned,
}

impl Scored {
    /// The scores, and what was compared, of a prediction for all pixels.
    pub(super) fn with_pixels(self, scene: &Scene<'_>) -> (Vec<ImageScore>, Compared) {
        let is_grouped = scene.protocol.grouping != Grouping::None;
        let of_pixel = |pixel: &Pixel| ComparedPixel {
            index: scene.truth.measured[pixel.place as usize] as usize,
            truth_m: pixel.truth_m,
            predicted_m: scene.scored_m(pixel.value, self.aligned),
        };
        let scored = |pixel: &&Pixel| !is_grouped || pixel.group.is_some();
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
            pixels: self.pixels.iter().filter(scored).map(of_pixel).collect(),
            predicted_m: predicted_m.collect(),
        };
        (self.scores, compared)
    }
}

struct Pixel {
    truth_m: f64,
    /// As in [`Predicted`].
    value: f64,
    /// In the list of measured pixels.
    place: u32,
    /// Predicted.
    disparity_px: f32,
    floored: bool,
    group: Option<Group>,
}

/// Pixels that are worked on together: few enough to stay in the processor's nearest memory.
const AT_A_TIME: usize = 256;

impl Scene<'_> {
    /// Visits the pixels that the protocol scores, row by row, and counts those without a prediction.
    fn visit(&self, tallies: &mut Tallies, mut each: impl FnMut(Pixel, &mut Tallies)) {
        let aligns_inverse_depth = self.protocol.alignment.is_of_inverse_depth();
        // Decided once: what is done at a pixel is a few instructions.
        match self.prediction {
            Prediction::DisparityFraction(values) if !aligns_inverse_depth => {
                self.visit_with(tallies, |at| Some(self.of_disparity(values[at])), &mut each);
            }
            _ => self.visit_with(tallies, |at| self.predicted(at), &mut each),
        }
    }

    fn visit_with(
        &self,
        tallies: &mut Tallies,
        predicted: impl Fn(usize) -> Option<Predicted>,
        mut each: impl FnMut(Pixel, &mut Tallies),
    ) {
        let truth = self.truth;
        for places in truth.within(self.crop) {
            for place in places {
                let Some(truth_m) = self.truth_m(place) else {
                    continue;
                };
                let index = truth.measured[place] as usize;
                let group = match self.protocol.grouping {
                    Grouping::None => None,
                    Grouping::Cityscapes => truth
                        .labels
                        .as_ref()
                        .and_then(|ids| Group::of_label(ids[index])),
                    Grouping::Distance => Group::of_depth(truth_m),
                };
                let at = match self.places {
                    Places::All => index,
                    Places::Measured => place,
                };
                let Some(predicted) = predicted(at).filter(|_| self.is_shown(index)) else {
                    tallies.add_unpredicted(group);
                    continue;
                };
                let pixel = Pixel {
                    truth_m,
                    value: predicted.value,
                    place: place as u32,
                    disparity_px: predicted.disparity_px,
                    floored: predicted.floored,
                    group,
                };
                each(pixel, tallies);
            }
        }
    }

    /// Adds pixels to what is known of their groups.
    fn add<const FURTHER: bool>(
        &self,
        pixels: &[Pixel],
        aligned: Aligned,
        finder: &mut Finder<'_>,
        tallies: &mut Tallies,
    ) {
        let strict = self.protocol.strict_comparisons;
        // First what calls for a logarithm, then sums, which so stay in the processor's registers.
        let terms = finder.terms(pixels.iter().map(|pixel| {
            let predicted_m = self.scored_m(pixel.value, aligned);
            (pixel.place, pixel.truth_m, predicted_m)
        }));
        if let [(None, all)] = tallies.groups.as_mut_slice() {
            let mut sums = all.sums;
            for terms in terms {
                sums.add::<FURTHER>(terms, strict);
            }
            all.sums = sums;
        } else {
            for (pixel, terms) in pixels.iter().zip(terms) {
                if let Some(own) = tallies.of(pixel.group) {
                    own.sums.add::<FURTHER>(terms, strict);
                }
            }
        }
        // Aligned depth no longer belongs to the disparity it was made of.
        let rule = self.protocol.d1_rule.filter(|_| aligned.fit.is_none());
        let disparities = rule.zip(self.truth.disparity_px.as_ref());
        for pixel in pixels {
            let Some(own) = tallies.of(pixel.group) else {
                continue;
            };
            own.floored += u64::from(pixel.floored);
            if let Some((rule, true_px)) = disparities {
                let true_px = true_px[pixel.place as usize];
                own.disparities.add(true_px, pixel.disparity_px, rule);
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
        let mut pixels = Vec::new();
        let mut finder = scratch.begin(truth.measured.len());
        let aligned = if protocol.alignment == Alignment::None {
            // Nothing has to be known of the other pixels.
            let aligned = Aligned::NOT;
            let mut some = Vec::with_capacity(AT_A_TIME);
            self.visit(&mut tallies, |pixel, tallies| {
                some.push(pixel);
                if some.len() == AT_A_TIME {
                    self.add::<FURTHER>(&some, aligned, &mut finder, tallies);
                    if kept {
                        pixels.append(&mut some);
                    }
                    some.clear();
                }
            });
            self.add::<FURTHER>(&some, aligned, &mut finder, &mut tallies);
            if kept {
                pixels.append(&mut some);
            }
            aligned
        } else {
            pixels.reserve_exact(truth.measured.len());
            self.visit(&mut tallies, |pixel, _| pixels.push(pixel));
            let pairs = pixels.iter().map(|pixel| (pixel.value, pixel.truth_m));
            let aligned = Aligned::of_pairs(protocol.alignment, pairs)?;
            if protocol.alignment.is_of_inverse_depth() {
                for pixel in &mut pixels {
                    pixel.floored = aligned.is_floored(pixel.value);
                }
            }
            for some in pixels.chunks(AT_A_TIME) {
                self.add::<FURTHER>(some, aligned, &mut finder, &mut tallies);
            }
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
