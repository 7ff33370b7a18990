//! Which points of a scan may fall into an image, decided in single precision for many at once.
//!
//! Five of six points of a scan lie beside the image, so most of the work is to pass them over. What
//! is passed over here is certainly outside; all others are left to the exact projection, so its
//! results do not change.

use std::ops::RangeInclusive;

/// Points looked at together: few enough for registers, many enough for vector units.
pub(crate) const BLOCK: usize = 16;

/// Sizes of coefficients that `f32` holds with all its digits, with room for their products.
const LARGEST_COEFFICIENTS: RangeInclusive<f64> = 1e-6..=1e6;

/// The part of space that an image shows.
///
/// With (u, v, w) the projection of a point, it falls on a pixel only if 0.5 <= u/w <= width + 0.5
/// and 0.5 <= v/w <= height + 0.5, that is, only if `u - 0.5 w`, `(width + 0.5) w - u`, `v - 0.5 w`
/// and `(height + 0.5) w - v` all have the sign of w. So points for which these differ in sign are
/// outside.
#[derive(Debug, Clone)]
pub(crate) struct Frustum {
    /// Coefficients of (x, y, z, 1) in the four expressions.
    sides: [[f32; 4]; 4],
    /// Error of an expression for each metre of |x| + |y| + |z| + 1.
    ///
    /// Rounding a coefficient, its product and the three additions changes a term by at most
    /// 5 x 2^-24 of its size, to first order; the size itself may be 3 x 2^-24 too small, and the exact
    /// projection in `f64` is 2^-29 times as wrong. 16 x 2^-24 leave room for all of it. Where a sum
    /// overflows, its sign is right or it is NaN, and nothing is less than NaN.
    slack: f32,
}

impl Frustum {
    /// That of a `width` x `height` image of a projection to 1-based pixels.
    pub fn new([u, v, w]: &[[f64; 4]; 3], width: usize, height: usize) -> Self {
        let combined = |a: f64, row: &[f64; 4], b: f64| {
            std::array::from_fn::<f64, 4, _>(|at| a * row[at] + b * w[at])
        };
        let sides = [
            combined(1.0, u, -0.5),
            combined(-1.0, u, width as f64 + 0.5),
            combined(1.0, v, -0.5),
            combined(-1.0, v, height as f64 + 0.5),
        ];
        let sizes = sides.as_flattened().iter().map(|n| n.abs());
        let largest = sizes.clone().fold(0.0, f64::max);
        let usable = LARGEST_COEFFICIENTS.contains(&largest) && !sizes.clone().any(f64::is_nan);
        let slack = match usable {
            true => (16.0 * 2.0_f64.powi(-24) * largest) as f32,
            // With such a projection nothing is certain.
            false => f32::INFINITY,
        };
        Self {
            sides: sides.map(|side| side.map(|n| n as f32)),
            slack,
        }
    }

    /// For every point whether it lies in front of the scanner (x >= 0) and may fall on a pixel.
    #[inline(always)]
    pub fn may_show(&self, [xs, ys, zs]: &[[f32; BLOCK]; 3]) -> [bool; BLOCK] {
        let [left, right, top, bottom] = self.sides;
        let mut shown = [false; BLOCK];
        for at in 0..BLOCK {
            let (x, y, z) = (xs[at], ys[at], zs[at]);
            let slack = self.slack * (x.abs() + y.abs() + z.abs() + 1.0);
            let a = left[0] * x + left[1] * y + left[2] * z + left[3];
            let b = right[0] * x + right[1] * y + right[2] * z + right[3];
            let c = top[0] * x + top[1] * y + top[2] * z + top[3];
            let d = bottom[0] * x + bottom[1] * y + bottom[2] * z + bottom[3];
            let least = lesser(lesser(a, b), lesser(c, d));
            let most = -lesser(lesser(-a, -b), lesser(-c, -d));
            let outside = (least < -slack) & (most > slack);
            shown[at] = (x >= 0.0) & !outside;
        }
        shown
    }
}

/// Without the care of [`f32::min`] for NaN, which proves nothing here whether it stays or goes.
#[inline(always)]
fn lesser(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}
