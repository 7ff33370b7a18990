//! Disparity and depth of a rectified stereo rig (PROTOCOL 3.4).

/// The baseline in metres that evaluation on stereo 2015 assumes for ground truth and
/// prediction alike. It is the rig's nominal value; no recording day has exactly this one.
pub const NOMINAL_BASELINE_M: f64 = 0.54;

/// The focal length in pixels that evaluation on stereo 2015 assumes for an image width;
/// `None` for a width that does not occur there (1226 among them).
pub fn nominal_focal_px(width: u32) -> Option<f64> {
    match width {
        1242 => Some(721.5377),
        1241 => Some(718.856),
        1238 => Some(718.3351),
        1224 => Some(707.0493),
        _ => None,
    }
}

/// Depth in metres along the optical axis: `focal_px * baseline_m / disparity_px`.
///
/// A disparity of zero is a point at infinity and gives `f64::INFINITY`.
pub fn depth_from_disparity_px(focal_px: f64, baseline_m: f64, disparity_px: f64) -> f64 {
    focal_px * baseline_m / disparity_px
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn nominal_rig() {
        assert_eq!(nominal_focal_px(1242), Some(721.5377));
        assert_eq!(nominal_focal_px(1226), None);
        // 721.5377 * 0.54 / 38.9630358 = 10 by hand
        assert!(
            (depth_from_disparity_px(721.5377, NOMINAL_BASELINE_M, 38.963_035_8) - 10.0).abs()
                < 1e-12
        );
        assert_eq!(
            depth_from_disparity_px(721.5377, NOMINAL_BASELINE_M, 0.0),
            f64::INFINITY
        );
    }

    proptest! {
        /// Stereo 2015 disparities are multiples of 1/256 px; depth stored in f32 keeps them exactly.
        #[test]
        fn disparities_survive_storage_as_f32_depth(raw in 1u16.., width in prop::sample::select(vec![1242u32, 1241, 1238, 1224])) {
            let focal_px = nominal_focal_px(width).unwrap();
            let depth_m = depth_from_disparity_px(focal_px, NOMINAL_BASELINE_M, f64::from(raw) / 256.0) as f32;
            let back = (256.0 * depth_from_disparity_px(focal_px, NOMINAL_BASELINE_M, f64::from(depth_m))).round();
            prop_assert_eq!(back, f64::from(raw));
        }
    }
}
