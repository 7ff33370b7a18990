//! What scoring compared of one image: all that a picture of its error needs.

use image::RgbImage;
use strat_metrics::{Compared, ImageScore, RowContext};
use strat_store::raster::Plane;

/// What a picture is made of: a prediction and what scoring compared of it.
#[derive(Clone, Debug)]
pub struct Comparison {
    /// Image id.
    pub image: String,
    /// The left image at full resolution.
    pub input: RgbImage,
    /// Predicted inverse depth in 1/m at the size of the image, scaled and clipped as it was scored.
    pub predicted: Plane,
    /// Model, data and protocol, as in the row of this image.
    pub context: RowContext,
    /// What was scored; none where the image has no row.
    pub scored: Option<Scored>,
}

/// What scoring made of one image.
#[derive(Clone, Debug)]
pub struct Scored {
    /// The scores of its rows.
    pub scores: Vec<ImageScore>,
    /// The pixels behind them.
    pub compared: Compared,
}

impl Comparison {
    /// Abs Rel of the image's row; none without a row, or where rows are about groups of pixels.
    #[must_use]
    pub fn abs_rel(&self) -> Option<f64> {
        match self.scored.as_ref()?.scores.as_slice() {
            [all] if all.group.is_none() => Some(all.metrics.abs_rel),
            _ => None,
        }
    }

    /// True inverse depth in 1/m where it was scored, 0 elsewhere; at the size of the ground truth.
    #[must_use]
    pub fn truth(&self) -> Plane {
        self.of_scored(0.0, |truth_m, _| 1.0 / truth_m)
    }

    /// |predicted - true| / true of depth where it was scored, -1 elsewhere; at the size of the ground
    /// truth.
    #[must_use]
    pub fn error(&self) -> Plane {
        self.of_scored(-1.0, |truth_m, predicted_m| {
            (predicted_m - truth_m).abs() / truth_m
        })
    }

    fn of_scored(&self, nothing: f32, value: impl Fn(f64, f64) -> f64) -> Plane {
        let Some(Scored { compared, .. }) = &self.scored else {
            return Plane::filled(self.predicted.width, self.predicted.height, nothing);
        };
        let mut plane = Plane::filled(compared.width, compared.height, nothing);
        for pixel in &compared.pixels {
            plane.data[pixel.index] = value(pixel.truth_m, pixel.predicted_m) as f32;
        }
        plane
    }
}
