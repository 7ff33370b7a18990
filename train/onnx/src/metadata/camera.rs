//! The cameras of a training set.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// How far a test camera may lie outside the training cameras before it is said.
const TOLERANCE: f64 = 0.05;

/// Mean and bounds of a positive number over the training pairs.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Spread {
    /// Mean over the pairs, each counting once.
    pub mean: f64,
    /// Smallest.
    pub lowest: f64,
    /// Largest.
    pub highest: f64,
}

impl Spread {
    /// The spread of the values; `None` without values, or where one is not a positive number.
    #[must_use]
    pub fn of(values: impl IntoIterator<Item = f64>) -> Option<Self> {
        let (mut sum, mut count) = (0.0, 0.0);
        let (mut lowest, mut highest) = (f64::INFINITY, 0.0_f64);
        for value in values {
            if !(value.is_finite() && value > 0.0) {
                return None;
            }
            sum += value;
            count += 1.0;
            lowest = lowest.min(value);
            highest = highest.max(value);
        }
        // Rounding must not put the mean of equal values beside them.
        let mean: f64 = sum / count;
        (count > 0.0).then(|| Self {
            mean: mean.clamp(lowest, highest),
            lowest,
            highest,
        })
    }

    fn holds(&self, value: f64) -> bool {
        (self.lowest * (1.0 - TOLERANCE)..=self.highest * (1.0 + TOLERANCE)).contains(&value)
    }
}

impl fmt::Display for Spread {
    /// One number where all pairs have the same, else mean, smallest and largest.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.lowest == self.highest {
            write!(f, "{}", self.mean)
        } else {
            write!(f, "{} {} {}", self.mean, self.lowest, self.highest)
        }
    }
}

impl FromStr for Spread {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let numbers: Result<Vec<f64>, _> = text.split_whitespace().map(str::parse).collect();
        let (mean, lowest, highest) = match numbers.as_deref() {
            Ok([value]) => (*value, *value, *value),
            Ok([mean, lowest, highest]) => (*mean, *lowest, *highest),
            _ => return Err(format!("\"{text}\" is not one or three numbers")),
        };
        let ordered = 0.0 < lowest && lowest <= mean && mean <= highest && highest.is_finite();
        if !ordered {
            return Err(format!("\"{text}\" is not a mean between positive bounds"));
        }
        Ok(Self {
            mean,
            lowest,
            highest,
        })
    }
}

/// The stereo cameras that a model's training pairs were taken with.
///
/// A network that predicts disparity has learned it for these cameras. An evaluation converts disparity
/// with the camera of the test image, as its protocol says; where that is another camera, depths are off
/// by about the ratio of the baselines.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrainingCamera {
    /// Focal length as a fraction of the image width.
    pub focal_fraction: Spread,
    /// Distance between the cameras in metres.
    pub baseline_m: Spread,
}

impl TrainingCamera {
    /// A sentence where a test camera is not like those of the training: more than a twentieth outside
    /// their bounds.
    #[must_use]
    pub fn difference(&self, focal_fraction: f64, baseline_m: f64) -> Option<String> {
        if self.focal_fraction.holds(focal_fraction) && self.baseline_m.holds(baseline_m) {
            return None;
        }
        Some(format!(
            "the model was trained with a focal length of {:.3} of the image width and a baseline of \
             {:.3} m, but this camera has {focal_fraction:.3} and {baseline_m:.3} m; metric depths of \
             this model do not apply to it without a correction",
            self.focal_fraction.mean, self.baseline_m.mean
        ))
    }
}
