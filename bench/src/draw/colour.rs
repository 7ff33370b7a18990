//! Colours of maps: gradients, and what is brightest.

use image::Rgb;
use strat_store::raster::Plane;

/// Depth and disparity: black is far, bright is near.
#[must_use]
pub fn magma(share: f32) -> Rgb<u8> {
    gradient(colorous::MAGMA, share)
}

/// Errors: grows in lightness alone, for colour-blind readers too. NaN is the bright end.
#[must_use]
pub fn cividis(share: f32) -> Rgb<u8> {
    gradient(colorous::CIVIDIS, if share.is_nan() { 1.0 } else { share })
}

fn gradient(gradient: colorous::Gradient, share: f32) -> Rgb<u8> {
    let share = if share.is_nan() {
        0.0
    } else {
        f64::from(share.clamp(0.0, 1.0))
    };
    let colour = gradient.eval_continuous(share);
    Rgb([colour.r, colour.g, colour.b])
}

/// The 95th percentile of the finite values, so that one near pixel does not darken the rest; above 0.
#[must_use]
pub fn brightest_of(map: &Plane) -> f32 {
    percentile_95(map.data.iter().copied()).max(f32::MIN_POSITIVE)
}

/// The value at the index `floor(0.95 (n - 1))` of the finite ones; 0 where there are none.
pub(crate) fn percentile_95(values: impl Iterator<Item = f32>) -> f32 {
    let mut values: Vec<f32> = values.filter(|value| value.is_finite()).collect();
    if values.is_empty() {
        return 0.0;
    }
    let index = (values.len() - 1) * 95 / 100;
    *values.select_nth_unstable_by(index, f32::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_that_are_not_numbers_do_not_stop_a_picture() {
        assert_eq!(magma(f32::NAN), magma(0.0));
        assert_eq!(magma(7.0), magma(1.0));
        assert_eq!(magma(f32::INFINITY), magma(1.0));
        assert_eq!(cividis(f32::NAN), cividis(1.0));
    }

    /// Bright is near, and bright is bad: gradients that are turned round are noticed.
    #[test]
    fn gradients_run_the_right_way() {
        let light = |colour: Rgb<u8>| colour.0.iter().map(|&c| u32::from(c)).sum::<u32>();
        assert!(light(magma(0.0)) < 20 && light(magma(1.0)) > 500);
        assert!(light(cividis(0.0)) < light(cividis(1.0)));
    }

    #[test]
    fn one_near_pixel_does_not_darken_the_rest() {
        let mut map = Plane::filled(10, 10, 2.0);
        map.data[3] = 900.0;
        map.data[4] = f32::NAN;
        assert_eq!(brightest_of(&map), 2.0);
        assert!(brightest_of(&Plane::filled(2, 2, 0.0)) > 0.0);
    }
}
