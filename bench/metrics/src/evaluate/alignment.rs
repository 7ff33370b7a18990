//! The fit of a prediction to the truth of its own image, before it is clipped (PROTOCOL 10.1).
//!
//! Double precision, sums around the means, so that a large shift costs no digits. Not here: which
//! pixels are scored, and what a protocol calls its alignment.

use super::error::EvaluateError;
use crate::metrics::median;
use crate::protocol::Alignment;

/// The two numbers by which a prediction was aligned with the truth of its image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fit {
    /// What predicted depth, or inverse depth where that is fitted, is multiplied by. Below 0 what is
    /// near is predicted as far; 0 for a prediction that is the same everywhere.
    pub scale: f64,
    /// What is added then: metres, or 1/m where inverse depth is fitted.
    pub shift: f64,
}

/// Least aligned inverse depth, 1/m: farther than 1000 m nothing is.
const INVERSE_DEPTH_FLOOR: f64 = 1e-3;

/// How values become depth in metres.
#[derive(Clone, Copy, Debug)]
pub(super) struct Aligned {
    /// `None` without alignment: the values are depth.
    pub(super) fit: Option<Fit>,
    is_inverse: bool,
}

impl Aligned {
    /// Without alignment.
    pub(super) const NOT: Self = Self {
        fit: None,
        is_inverse: false,
    };

    /// Fits pairs of predicted value and true depth (above 0, in metres): the values are inverse
    /// depth if the alignment fits that, depth otherwise.
    pub(super) fn of_pairs(
        alignment: Alignment,
        pairs: impl Iterator<Item = (f64, f64)> + Clone,
    ) -> Result<Self, EvaluateError> {
        let is_inverse = alignment.is_of_inverse_depth();
        let nothing = || EvaluateError::NothingToFit { alignment };
        // What is not above 0 is no inverse depth: it is scored, but says nothing about the fit.
        let inverse = || {
            let usable = pairs.clone().filter(|(value, _)| *value > 0.0);
            usable.map(|(value, truth_m)| (value, 1.0 / truth_m))
        };
        let is_empty = pairs.clone().next().is_none();
        let fit = match alignment {
            Alignment::None => None,
            _ if is_empty => None,
            Alignment::Median => Some(medians(pairs)?),
            Alignment::ScaleDepth => Some(factor(pairs).ok_or_else(nothing)?),
            Alignment::AffineDepth => Some(line(pairs).ok_or_else(nothing)?),
            Alignment::ScaleDisparity => Some(factor(inverse()).ok_or_else(nothing)?),
            Alignment::AffineDisparity => Some(line(inverse()).ok_or_else(nothing)?),
        };
        match fit {
            Some(Fit { scale, shift }) if !(scale.is_finite() && shift.is_finite()) => {
                Err(EvaluateError::Unbounded { alignment })
            }
            fit => Ok(Self { fit, is_inverse }),
        }
    }

    #[inline]
    fn moved(self, value: f64) -> f64 {
        match self.fit {
            Some(Fit { scale, shift }) => scale * value + shift,
            None => value,
        }
    }

    /// Depth in metres of a value, before it is clipped.
    #[inline]
    pub(super) fn depth_m(self, value: f64) -> f64 {
        if self.is_inverse {
            1.0 / self.moved(value).max(INVERSE_DEPTH_FLOOR)
        } else {
            self.moved(value)
        }
    }

    /// Whether the aligned inverse depth of a value is raised to the floor.
    #[inline]
    pub(super) fn is_floored(self, value: f64) -> bool {
        self.is_inverse && self.moved(value) < INVERSE_DEPTH_FLOOR
    }
}

/// median(true) / median(predicted).
fn medians(pairs: impl Iterator<Item = (f64, f64)>) -> Result<Fit, EvaluateError> {
    let (mut predicted, mut truth): (Vec<f64>, Vec<f64>) = pairs.unzip();
    // Never without pixels here.
    let truth = median(&mut truth).unwrap_or(f64::NAN);
    let predicted = median(&mut predicted).unwrap_or(f64::NAN);
    if predicted.is_finite() && predicted > 0.0 {
        Ok(Fit {
            scale: truth / predicted,
            shift: 0.0,
        })
    } else {
        Err(EvaluateError::Median(predicted))
    }
}

/// Least squares of `s x` to y; `None` where every x is 0 and without any.
fn factor(pairs: impl Iterator<Item = (f64, f64)>) -> Option<Fit> {
    let (mut products, mut squares) = (0.0, 0.0);
    for (x, y) in pairs {
        products += x * y;
        squares += x * x;
    }
    (squares != 0.0).then(|| Fit {
        scale: products / squares,
        shift: 0.0,
    })
}

/// Least squares of `s x + t` to y. With fewer than two distinct x there is no scale to be told: it
/// is 0, and the shift is the mean. `None` without any pair.
fn line(pairs: impl Iterator<Item = (f64, f64)> + Clone) -> Option<Fit> {
    let (mut count, mut sum_x, mut sum_y) = (0.0, 0.0, 0.0);
    let (mut least, mut most) = (f64::INFINITY, f64::NEG_INFINITY);
    for (x, y) in pairs.clone() {
        count += 1.0;
        sum_x += x;
        sum_y += y;
        least = least.min(x);
        most = most.max(x);
    }
    if count == 0.0 {
        return None;
    }
    let (mean_x, mean_y) = (sum_x / count, sum_y / count);
    let (mut products, mut squares) = (0.0, 0.0);
    for (x, y) in pairs {
        products += (x - mean_x) * (y - mean_y);
        squares += (x - mean_x) * (x - mean_x);
    }
    // The rounded mean of equal values need not be one of them.
    let scale = if least < most && squares > 0.0 {
        products / squares
    } else {
        0.0
    };
    Some(Fit {
        scale,
        shift: mean_y - scale * mean_x,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const TRUTH_M: [f64; 5] = [2.0, 4.0, 9.5, 31.0, 80.0];

    fn aligned(alignment: Alignment, values: &[f64]) -> Result<Aligned, EvaluateError> {
        Aligned::of_pairs(alignment, values.iter().copied().zip(TRUTH_M))
    }

    fn close(found: f64, expected: f64) -> bool {
        (found - expected).abs() <= 1e-12 * expected.abs().max(1.0)
    }

    /// By hand: values that differ from the truth by known numbers come back as the truth.
    #[test]
    fn what_was_distorted_by_scale_and_shift_comes_back() {
        for (alignment, distort, scale, shift) in [
            (Alignment::Median, (|g| g / 3.0) as fn(f64) -> f64, 3.0, 0.0),
            (Alignment::ScaleDepth, |g| g / 3.0, 3.0, 0.0),
            (Alignment::AffineDepth, |g| (g - 7.0) / 3.0, 3.0, 7.0),
            (Alignment::ScaleDisparity, |g| 50.0 / g, 0.02, 0.0),
            (
                Alignment::AffineDisparity,
                |g| (1.0 / g + 0.4) / 0.02,
                0.02,
                -0.4,
            ),
            // Near is far and far is near.
            (Alignment::AffineDepth, |g| -g, -1.0, 0.0),
        ] {
            let values = TRUTH_M.map(distort);
            let found = aligned(alignment, &values).unwrap();
            let fit = found.fit.unwrap();
            assert!(close(fit.scale, scale), "{alignment}: {fit:?}");
            assert!(close(fit.shift, shift), "{alignment}: {fit:?}");
            for (value, truth_m) in values.into_iter().zip(TRUTH_M) {
                assert!(close(found.depth_m(value), truth_m), "{alignment} {value}");
                assert!(!found.is_floored(value));
            }
        }
        let none = aligned(Alignment::None, &TRUTH_M).unwrap();
        assert_eq!((none.fit, none.depth_m(5.0)), (None, 5.0));
    }

    /// An offset a million times the signal costs no digit that single precision has.
    #[test]
    fn a_large_shift_costs_no_digits() {
        let values = TRUTH_M.map(|g| 1e6 + g);
        let fit = aligned(Alignment::AffineDepth, &values)
            .unwrap()
            .fit
            .unwrap();
        assert!((fit.scale - 1.0).abs() < 1e-9, "{fit:?}");
    }

    #[test]
    fn values_that_are_the_same_everywhere_have_no_scale() {
        // 0.1 as f32: its mean over five is another number.
        let flat = [f64::from(0.1_f32); 5];
        let depth = aligned(Alignment::AffineDepth, &flat).unwrap();
        let mean = TRUTH_M.iter().sum::<f64>() / 5.0;
        let fit = depth.fit.unwrap();
        assert!(fit.scale == 0.0 && close(fit.shift, mean), "{fit:?}");
        // One value is as flat as many.
        let one = aligned(Alignment::AffineDisparity, &[0.0, -1.0, 3.0, 0.0, 0.0]).unwrap();
        let fit = one.fit.unwrap();
        assert!(fit.scale == 0.0 && close(fit.shift, 1.0 / 9.5), "{fit:?}");
    }

    /// By hand: of 2, 1 and 0 the first two fit 1/2 and 1/4 exactly, with a scale of 1/4; 0 becomes
    /// the floor, which is 1000 m.
    #[test]
    fn inverse_depth_of_nothing_is_scored_but_not_fitted() {
        let found = aligned(Alignment::ScaleDisparity, &[2.0, 1.0, 0.0, -3.0, 0.0]).unwrap();
        assert!(close(found.fit.unwrap().scale, 0.25));
        assert!(close(found.depth_m(0.0), 1000.0) && found.is_floored(0.0));
        assert!(close(found.depth_m(2.0), 2.0) && !found.is_floored(2.0));
    }

    #[test]
    fn what_cannot_be_fitted_is_an_error() {
        for alignment in [Alignment::ScaleDisparity, Alignment::AffineDisparity] {
            let error = aligned(alignment, &[0.0, -1.0, 0.0, 0.0, 0.0]).unwrap_err();
            assert!(
                error.to_string().contains("no inverse depth above 0"),
                "{error}"
            );
        }
        let error = aligned(Alignment::ScaleDepth, &[0.0; 5]).unwrap_err();
        assert!(error.to_string().contains("0 at all pixels"), "{error}");
        let error = aligned(Alignment::Median, &[0.0; 5]).unwrap_err();
        assert!(error.to_string().contains("median"), "{error}");
        let infinite = [f64::INFINITY, 1.0, 2.0, 3.0, 4.0];
        let error = aligned(Alignment::AffineDepth, &infinite).unwrap_err();
        assert!(error.to_string().contains("infinite"), "{error}");
        // Whether there is nothing to score is said elsewhere.
        let none = Aligned::of_pairs(Alignment::AffineDepth, std::iter::empty()).unwrap();
        assert_eq!(none.fit, None);
    }
}
