//! The pixels of an image that a protocol scores, and what is predicted there.
//!
//! Not here: what one pixel is ([`super::scene`](mod@super::scene)), and what is made of all
//! ([`super::score`](mod@super::score)).

use std::ops::Range;

use super::prediction::Prediction;
use super::scene::{Places, Predicted, Scene};
use super::tallies::Tallies;
use crate::protocol::{Group, Grouping};
use crate::sums::AT_A_TIME;

/// Pixels that a protocol scores, row by row. A list for each thing that is known of them, because what is
/// worked out of several pixels at once must lie side by side.
#[derive(Default)]
pub(super) struct Pixels {
    /// In the list of measured pixels.
    pub(super) places: Vec<u32>,
    pub(super) truth_m: Vec<f64>,
    /// As in [`Predicted`].
    pub(super) values: Vec<f64>,
    /// Predicted.
    pub(super) disparities_px: Vec<f32>,
    pub(super) floored: Vec<bool>,
    /// Of protocols with groups alone.
    pub(super) groups: Vec<Option<Group>>,
}

impl Pixels {
    pub(super) fn reserve(&mut self, count: usize, is_grouped: bool) {
        self.places.reserve_exact(count);
        self.truth_m.reserve_exact(count);
        self.values.reserve_exact(count);
        self.disparities_px.reserve_exact(count);
        self.floored.reserve_exact(count);
        self.groups
            .reserve_exact(if is_grouped { count } else { 0 });
    }

    /// Room for what is predicted at each of the places.
    fn resize_predicted(&mut self) {
        let count = self.places.len();
        self.values.resize(count, 0.0);
        self.disparities_px.resize(count, 0.0);
        self.floored.resize(count, false);
    }

    fn set_predicted(&mut self, at: usize, predicted: &Predicted) {
        self.values[at] = predicted.value;
        self.disparities_px[at] = predicted.disparity_px;
        self.floored[at] = predicted.floored;
    }

    pub(super) fn truncate(&mut self, count: usize) {
        self.places.truncate(count);
        self.truth_m.truncate(count);
        self.values.truncate(count);
        self.disparities_px.truncate(count);
        self.floored.truncate(count);
        self.groups.truncate(count);
    }

    pub(super) fn append(&mut self, more: &Self) {
        self.places.extend_from_slice(&more.places);
        self.truth_m.extend_from_slice(&more.truth_m);
        self.values.extend_from_slice(&more.values);
        self.disparities_px.extend_from_slice(&more.disparities_px);
        self.floored.extend_from_slice(&more.floored);
        self.groups.extend_from_slice(&more.groups);
    }
}

impl Scene<'_> {
    /// Lists the pixels that the protocol scores, row by row, and counts those without a prediction. Hands
    /// the list over after each row that leaves [`AT_A_TIME`] or more in it.
    pub(super) fn visit(
        &self,
        pixels: &mut Pixels,
        tallies: &mut Tallies,
        mut full: impl FnMut(&mut Pixels, &mut Tallies),
    ) {
        for places in self.truth.within(self.crop) {
            let first = pixels.places.len();
            self.list(places, &mut pixels.places, &mut pixels.truth_m);
            self.list_groups(pixels, first);
            self.list_predicted(pixels, first, tallies);
            if pixels.places.len() >= AT_A_TIME {
                full(pixels, tallies);
            }
        }
    }

    /// Adds the groups of the pixels from `first` on.
    fn list_groups(&self, pixels: &mut Pixels, first: usize) {
        let Pixels {
            places,
            truth_m,
            groups,
            ..
        } = pixels;
        match self.protocol.grouping {
            Grouping::None => {}
            Grouping::Cityscapes => groups.extend(places[first..].iter().map(|place| {
                let index = self.truth.measured[*place as usize] as usize;
                let labels = self.truth.labels.as_ref();
                labels.and_then(|ids| Group::of_label(ids[index]))
            })),
            Grouping::Distance => {
                groups.extend(
                    truth_m[first..]
                        .iter()
                        .map(|truth_m| Group::of_depth(*truth_m)),
                );
            }
        }
    }

    /// Adds what is predicted at the pixels from `first` on, and takes out those without a prediction.
    fn list_predicted(&self, pixels: &mut Pixels, first: usize, tallies: &mut Tallies) {
        let at = |place: &u32| match self.places {
            Places::All => self.truth.measured[*place as usize] as usize,
            Places::Measured => *place as usize,
        };
        pixels.resize_predicted();
        match self.prediction {
            // Each has one: a disparity of 0 is raised to the floor.
            Prediction::DisparityFraction(values)
                if self.shown.is_none() && !self.protocol.alignment.is_of_inverse_depth() =>
            {
                // First the fractions, from wherever they lie, then many at a time what they mean.
                let disparities_px = &mut pixels.disparities_px[first..];
                let places = &pixels.places[first..];
                match (self.places, places) {
                    (Places::Measured, [from, .., to])
                        if (to - from) as usize + 1 == places.len() =>
                    {
                        disparities_px.copy_from_slice(&values[*from as usize..=*to as usize]);
                    }
                    _ => {
                        for (fraction, place) in disparities_px.iter_mut().zip(places) {
                            *fraction = values[at(place)];
                        }
                    }
                }
                let predicted = pixels.values[first..].iter_mut();
                let predicted = predicted.zip(&mut pixels.floored[first..]);
                for (disparity_px, (value, floored)) in disparities_px.iter_mut().zip(predicted) {
                    let predicted = self.of_disparity(*disparity_px);
                    *disparity_px = predicted.disparity_px;
                    *value = predicted.value;
                    *floored = predicted.floored;
                }
            }
            _ => {
                let mut kept = first;
                for here in first..pixels.places.len() {
                    let place = pixels.places[here];
                    let index = self.truth.measured[place as usize] as usize;
                    let predicted = self.predicted(at(&place)).filter(|_| self.is_shown(index));
                    match predicted {
                        None => tallies.add_unpredicted(pixels.groups.get(here).copied().flatten()),
                        Some(predicted) => {
                            pixels.set_predicted(kept, &predicted);
                            pixels.places[kept] = place;
                            pixels.truth_m[kept] = pixels.truth_m[here];
                            if let Some(group) = pixels.groups.get(here) {
                                pixels.groups[kept] = *group;
                            }
                            kept += 1;
                        }
                    }
                }
                pixels.truncate(kept);
            }
        }
    }

    /// Lists the measured pixels among some places that the protocol does not mask, with their true depth in
    /// metres.
    fn list(&self, some: Range<usize>, places: &mut Vec<u32>, truth_m: &mut Vec<f64>) {
        let (measured, is_disparity) = self.measured_values();
        let measured = &measured[some.clone()];
        match is_disparity {
            true => {
                let depth_m = |disparity_px| self.focal_baseline / disparity_px;
                self.list_depths(some.start, measured, depth_m, places, truth_m);
            }
            false => self.list_depths(some.start, measured, |depth_m| depth_m, places, truth_m),
        }
    }

    /// In most places all count, which is seen of several at a time. Where not, which ones do is as good as
    /// chance to the processor, so each is written down and the next one written over those that do not.
    fn list_depths(
        &self,
        start: usize,
        measured: &[f32],
        depth_m: impl Fn(f64) -> f64,
        places: &mut Vec<u32>,
        truth_m: &mut Vec<f64>,
    ) {
        const PIECE: usize = 16;
        let [nearest_m, farthest_m] = self.counted_m;
        let counts = |value: f32, depth_m: f64| {
            (value != 0.0) & (depth_m >= nearest_m) & (depth_m <= farthest_m)
        };
        let mut depths_m = [0.0; PIECE];
        for (first, piece) in (start..).step_by(PIECE).zip(measured.chunks(PIECE)) {
            let depths_m = &mut depths_m[..piece.len()];
            let mut all_count = true;
            for (found, value) in depths_m.iter_mut().zip(piece) {
                *found = depth_m(f64::from(*value));
                all_count &= counts(*value, *found);
            }
            let mut count = places.len();
            places.extend(first as u32..(first + piece.len()) as u32);
            truth_m.extend_from_slice(depths_m);
            if all_count {
                continue;
            }
            for (place, (value, depth_m)) in (first as u32..).zip(piece.iter().zip(&*depths_m)) {
                places[count] = place;
                truth_m[count] = *depth_m;
                count += usize::from(counts(*value, *depth_m));
            }
            places.truncate(count);
            truth_m.truncate(count);
        }
    }
}
