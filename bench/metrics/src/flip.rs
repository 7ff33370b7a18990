//! Flip post-processing of a network's disparity.

/// Blends the disparity of an image with that of its mirror image (PROTOCOL 3.7), both
/// row-major at network size; `of_mirrored` as the network returned it, not mirrored back.
///
/// The left 5 % of the columns come from the mirrored pass and the right 5 % from the plain
/// one, where each knows what the other cannot see; up to 10 % one hands over to the average
/// of both.
///
/// # Panics
/// If the planes differ in length or are no whole number of rows.
pub fn flip_blend(disparity: &[f32], of_mirrored: &[f32], width: usize) -> Vec<f32> {
    assert_eq!(disparity.len(), of_mirrored.len(), "planes of one size");
    assert!(
        width > 0 && disparity.len().is_multiple_of(width),
        "whole rows"
    );
    let left_weight = |column: usize| {
        let t = column as f64 / (width.max(2) - 1) as f64;
        1.0 - (20.0 * (t - 0.05)).clamp(0.0, 1.0)
    };
    let mut blended = Vec::with_capacity(disparity.len());
    for (plain, mirrored) in disparity.chunks(width).zip(of_mirrored.chunks(width)) {
        for column in 0..width {
            let (l, r) = (left_weight(column), left_weight(width - 1 - column));
            let d = f64::from(plain[column]);
            let back = f64::from(mirrored[width - 1 - column]);
            blended.push((r * d + l * back + (1.0 - l - r) * 0.5 * (d + back)) as f32);
        }
    }
    blended
}
