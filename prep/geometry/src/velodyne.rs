//! Depth images from Velodyne scans (PROTOCOL 3.5), reproducing the evaluation that all
//! published Eigen-split figures use, including its quirks.
//!
//! Two of its habits are wrong and kept for comparison: the depth it stores is the distance
//! along the *scanner's* x axis rather than the camera's optical axis
//! ([`DepthAxis::CameraZ`] is the right one), and its search for points falling on one pixel
//! also merges the last pixel of a row with the first of the next.

use std::borrow::Borrow;

use crate::calibration::{CamToCam, VeloToCam};

/// A scan that cannot be read.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ScanError {
    /// Not a whole number of points.
    #[error(
        "a Velodyne scan is rows of four 32-bit numbers, but {bytes} bytes are not a multiple of 16; \
         the file is truncated or not a scan"
    )]
    Truncated {
        /// Size of what was given.
        bytes: usize,
    },
    /// No points at all.
    #[error("the Velodyne scan is empty (0 bytes)")]
    Empty,
}

/// What the value of a depth pixel is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum DepthAxis {
    /// Metres along the scanner's x axis: what published evaluations use.
    VelodyneX,
    /// Metres along the optical axis of the left camera: geometrically right.
    CameraZ,
}

/// Reads a scan: little-endian `f32` rows of x forward, y left, z up (metres), reflectance.
///
/// # Errors
/// The bytes are not a whole, positive number of points.
pub fn parse_velodyne(bytes: &[u8]) -> Result<Vec<[f32; 4]>, ScanError> {
    Ok(velodyne_points(bytes)?.collect())
}

/// As [`parse_velodyne`], point by point without a copy of the scan.
///
/// # Errors
/// The bytes are not a whole, positive number of points.
pub fn velodyne_points(
    bytes: &[u8],
) -> Result<impl ExactSizeIterator<Item = [f32; 4]> + Clone, ScanError> {
    let (points, rest) = bytes.as_chunks::<16>();
    if !rest.is_empty() {
        return Err(ScanError::Truncated { bytes: bytes.len() });
    }
    if points.is_empty() {
        return Err(ScanError::Empty);
    }
    let number = |p: &[u8; 16], i: usize| {
        f32::from_le_bytes([p[4 * i], p[4 * i + 1], p[4 * i + 2], p[4 * i + 3]])
    };
    Ok(points
        .iter()
        .map(move |p| std::array::from_fn(|i| number(p, i))))
}

/// The matrix from homogeneous Velodyne points to homogeneous pixels of the left camera:
/// `P_rect_02 * R_rect_00 * [R|T]`, the latter two padded to 4 x 4.
pub fn velodyne_projection(cam: &CamToCam, velo: &VeloToCam) -> [[f64; 4]; 3] {
    let mut rectify = [[0.0; 4]; 4];
    let mut transform = [[0.0; 4]; 4];
    for row in 0..3 {
        rectify[row][..3].copy_from_slice(&cam.r_rect_00[row]);
        transform[row][..3].copy_from_slice(&velo.rotation[row]);
        transform[row][3] = velo.translation[row];
    }
    rectify[3][3] = 1.0;
    transform[3][3] = 1.0;
    product(&product(&cam.p_rect_02, &rectify), &transform)
}

/// The depth image of a scan: `width * height` values in metres, row by row, 0 where nothing was measured.
///
/// `projection` comes from [`velodyne_projection`]. Points behind the scanner (x < 0) are
/// dropped; pixels are 1-based in the projection and rounded half to even; of several
/// points on a pixel the nearest stays. Negative depths become 0.
///
/// `points` are those of [`parse_velodyne`] or [`velodyne_points`].
pub fn velodyne_depth<P: Borrow<[f32; 4]>>(
    points: impl IntoIterator<Item = P>,
    projection: &[[f64; 4]; 3],
    width: usize,
    height: usize,
    axis: DepthAxis,
) -> Vec<f32> {
    let mut depth_m = vec![0.0_f32; width * height];
    if depth_m.is_empty() {
        return Vec::new();
    }
    let (columns, rows) = (width as f64, height as f64);
    // Hits of the first and the last column, where points of two pixels share a search key.
    let mut sides = Vec::new();
    // Inner pixels that a point without a positive depth fell on: nothing is nearer than that.
    let mut blank = Vec::new();
    for point in points {
        let [x, y, z, _] = *point.borrow();
        if x.is_nan() || x < 0.0 {
            continue;
        }
        let point = [f64::from(x), f64::from(y), f64::from(z), 1.0];
        let [u, v, w] = projection
            .map(|row| row[0] * point[0] + row[1] * point[1] + row[2] * point[2] + row[3]);
        // Most points lie far outside the image; these comparisons cost less than the divisions.
        if w > 0.0 && (u < 0.0 || v < 0.0 || u > (columns + 1.0) * w || v > (rows + 1.0) * w) {
            continue;
        }
        let (u, v) = (u / w, v / w);
        if !(u >= 0.0 && v >= 0.0 && u <= columns + 1.0 && v <= rows + 1.0) {
            continue;
        }
        let (column, row) = (half_to_even(u) - 1.0, half_to_even(v) - 1.0);
        if column < 0.0 || row < 0.0 || column >= columns || row >= rows {
            continue;
        }
        let (column, row) = (column as usize, row as usize);
        let pixel = row * width + column;
        // Rounding keeps the order, so the nearest of the rounded is the rounded nearest.
        let value = match axis {
            DepthAxis::VelodyneX => x,
            DepthAxis::CameraZ => w as f32,
        };
        if column == 0 || column == width - 1 {
            sides.push((row * (width - 1) + column, pixel, value));
        } else if value > 0.0 {
            let nearest = &mut depth_m[pixel];
            *nearest = if *nearest == 0.0 {
                value
            } else {
                nearest.min(value)
            };
        } else {
            blank.push(pixel);
        }
    }
    for pixel in blank {
        depth_m[pixel] = 0.0;
    }
    // Last in file order stays, then the first pixel of a key is given the nearest of the key.
    for &(_, pixel, value) in &sides {
        depth_m[pixel] = value.max(0.0);
    }
    sides.sort_by_key(|(key, ..)| *key);
    for group in sides.chunk_by(|a, b| a.0 == b.0).filter(|g| g.len() > 1) {
        let nearest = group
            .iter()
            .fold(f32::INFINITY, |least, hit| least.min(hit.2));
        depth_m[group[0].1] = nearest.max(0.0);
    }
    depth_m
}

/// Rounds half to even. Exact for what passes the comparisons before it, which is far below 2^51
/// in size; without SSE4.1 the standard method is a library call.
fn half_to_even(number: f64) -> f64 {
    const SHIFT: f64 = 6_755_399_441_055_744.0;
    number + SHIFT - SHIFT
}

fn product(left: &[[f64; 4]; 3], right: &[[f64; 4]; 4]) -> [[f64; 4]; 3] {
    left.map(|row| std::array::from_fn(|column| (0..4).map(|k| row[k] * right[k][column]).sum()))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::calibration::tests::{CAM, VELO};

    /// u = 5.5 - 10 y/x, v = 4.5 - 10 z/x: a camera at the scanner looking along x.
    const PLAIN: [[f64; 4]; 3] = [
        [5.5, -10.0, 0.0, 0.0],
        [4.5, 0.0, -10.0, 0.0],
        [1.0, 0.0, 0.0, 0.0],
    ];

    #[test]
    fn ties_round_to_even_and_the_nearest_point_stays() {
        let points = [
            [10.0_f32, 0.0, 0.0, 0.5],
            [20.0, 0.0, 0.0, 0.5],
            [-5.0, 0.0, 0.0, 0.1],
        ];
        let depth = velodyne_depth(points, &PLAIN, 9, 8, DepthAxis::VelodyneX);
        // 5.5 -> 6 and 4.5 -> 4, minus the one of 1-based pixels: row 3, column 5
        assert_eq!(depth[3 * 9 + 5], 10.0);
        assert_eq!(depth.iter().filter(|d| **d > 0.0).count(), 1);
        let swapped = [points[1], points[0]];
        assert_eq!(
            velodyne_depth(swapped, &PLAIN, 9, 8, DepthAxis::VelodyneX),
            depth
        );
    }

    #[test]
    fn row_ends_are_merged_with_the_next_row_starts_as_the_reference_does() {
        // Width 3: pixel (0, 2) and pixel (1, 0) share a key. Both points keep a pixel, but
        // the first in file order is given the nearest depth of the two.
        let pixel_row_col = |row: f32, col: f32, x: f32| {
            [
                x,
                (5.5 - 1.0 - col) * x / 10.0,
                (4.5 - 1.0 - row) * x / 10.0,
                0.0,
            ]
        };
        let points = [pixel_row_col(0.0, 2.0, 16.0), pixel_row_col(1.0, 0.0, 8.0)];
        let depth = velodyne_depth(points, &PLAIN, 3, 2, DepthAxis::VelodyneX);
        assert_eq!(depth, [0.0, 0.0, 8.0, 8.0, 0.0, 0.0]);
    }

    /// PROTOCOL 3.5 step by step, with the search for repeated keys written as it is stated there.
    fn step_by_step(
        points: &[[f32; 4]],
        projection: &[[f64; 4]; 3],
        (width, height): (usize, usize),
        axis: DepthAxis,
    ) -> Vec<f32> {
        let mut hits = Vec::new();
        for &[x, y, z, _] in points.iter().filter(|p| p[0] >= 0.0) {
            let [u, v, w] = projection.map(|row| {
                row[0] * f64::from(x) + row[1] * f64::from(y) + row[2] * f64::from(z) + row[3]
            });
            let column = (u / w).round_ties_even() - 1.0;
            let row = (v / w).round_ties_even() - 1.0;
            if column >= 0.0 && row >= 0.0 && column < width as f64 && row < height as f64 {
                let value = match axis {
                    DepthAxis::VelodyneX => f64::from(x),
                    DepthAxis::CameraZ => w,
                };
                hits.push((row as usize, column as usize, value));
            }
        }
        let mut depth_m = vec![0.0_f64; width * height];
        for &(row, column, value) in &hits {
            depth_m[row * width + column] = value;
        }
        let key = |hit: &(usize, usize, f64)| hit.0 * (width - 1) + hit.1;
        for first in 0..hits.len() {
            let same: Vec<_> = hits
                .iter()
                .filter(|h| key(h) == key(&hits[first]))
                .collect();
            if same.len() > 1 {
                let nearest = same.iter().map(|h| h.2).fold(f64::INFINITY, f64::min);
                depth_m[same[0].0 * width + same[0].1] = nearest;
            }
        }
        let kept = depth_m
            .into_iter()
            .map(|d| if d < 0.0 { 0.0 } else { d as f32 });
        kept.collect()
    }

    #[test]
    fn odd_points_and_images_do_no_harm() {
        let points = [
            [f32::NAN, 0.0, 0.0, 0.0],
            [1.0, f32::NAN, 0.0, 0.0],
            [f32::INFINITY, 0.0, 0.0, 0.0],
            [0.0, 0.0, 0.0, 0.0],
            [f32::MAX, f32::MIN, 0.0, 0.0],
        ];
        assert!(
            velodyne_depth(points, &PLAIN, 9, 8, DepthAxis::VelodyneX)
                .iter()
                .all(|d| *d == 0.0)
        );
        assert!(velodyne_depth(points, &PLAIN, 0, 8, DepthAxis::VelodyneX).is_empty());
        assert_eq!(
            velodyne_depth(
                [[1.0_f32, 0.45, 0.35, 0.0]],
                &PLAIN,
                1,
                1,
                DepthAxis::CameraZ
            ),
            [1.0]
        );
    }

    #[test]
    fn a_scan_is_read_little_endian() {
        let mut bytes = Vec::new();
        for number in [1.0_f32, -2.5, 0.125, 0.5, 7.0, 8.0, 9.0, 0.0] {
            bytes.extend(number.to_le_bytes());
        }
        assert_eq!(
            parse_velodyne(&bytes).unwrap(),
            [[1.0, -2.5, 0.125, 0.5], [7.0, 8.0, 9.0, 0.0]]
        );
        assert_eq!(
            parse_velodyne(&bytes[..30]),
            Err(ScanError::Truncated { bytes: 30 })
        );
        assert_eq!(parse_velodyne(&[]), Err(ScanError::Empty));
    }

    /// 40,000 points without transcendental functions, so that every language makes the same ones.
    fn closed_form_cloud() -> Vec<[f32; 4]> {
        (0..40_000_i64)
            .map(|i| {
                let x = (i * 37 % 640 - 40) as f32 / 8.0;
                let y = (i * 101 % 1601 - 800) as f32 / 16.0;
                let z = (i * 53 % 257 - 192) as f32 / 64.0;
                [x, y, z, 0.5]
            })
            .collect()
    }

    /// (pixels with a depth, sum over pixels of value bits times 1-based index, modulo 2^64)
    fn fingerprint(depth_m: &[f32]) -> (usize, u64) {
        let hash = depth_m
            .iter()
            .zip(1_u64..)
            .map(|(d, i)| u64::from(d.to_bits()).wrapping_mul(i));
        (
            depth_m.iter().filter(|d| **d > 0.0).count(),
            hash.fold(0, u64::wrapping_add),
        )
    }

    #[test]
    fn depth_images_equal_the_oracle_bit_for_bit() {
        // Recipe: oracle.velo_depth_map(closed_form_cloud, oracle.velo_projection(CAM, VELO),
        // height, width, depth).astype(float32), collisions "reference", then `fingerprint`.
        // 62 x 24 with the projection scaled by 1/20 makes nearly every pixel a collision.
        let cam = CamToCam::parse(CAM).unwrap();
        let projection = velodyne_projection(&cam, &VeloToCam::parse(VELO).unwrap());
        let mut small = projection;
        for row in &mut small[..2] {
            *row = row.map(|n| n / 20.0);
        }
        let points = closed_form_cloud();
        let cases = [
            (
                &projection,
                1242,
                375,
                DepthAxis::VelodyneX,
                (20150, 5472092677930057728),
            ),
            (
                &projection,
                1242,
                375,
                DepthAxis::CameraZ,
                (20150, 5471624643092309257),
            ),
            (&small, 62, 18, DepthAxis::VelodyneX, (717, 518048001490944)),
            (&small, 62, 18, DepthAxis::CameraZ, (717, 517883872779604)),
        ];
        for (projection, width, height, axis, expected) in cases {
            let depth_m = velodyne_depth(&points, projection, width, height, axis);
            assert_eq!(fingerprint(&depth_m), expected, "{width}x{height} {axis:?}");
        }
    }

    proptest! {
        #[test]
        fn no_depth_is_negative_or_farther_than_its_points(
            points in prop::collection::vec(prop::array::uniform4(-100.0_f32..100.0), 1..200)
        ) {
            let far = points.iter().map(|p| p[0]).fold(0.0_f32, f32::max);
            for axis in [DepthAxis::VelodyneX, DepthAxis::CameraZ] {
                let depth_m = velodyne_depth(&points, &PLAIN, 12, 9, axis);
                prop_assert_eq!(depth_m.len(), 108);
                prop_assert!(depth_m.iter().all(|d| (0.0..=far).contains(d)));
            }
        }

        /// Coarse coordinates make ties, repeated pixels, points on the scanner and behind the camera common.
        #[test]
        fn images_equal_the_definition(
            points in prop::collection::vec((-2_i8..12, -20_i8..20, -20_i8..20), 0..120),
            width in 1_usize..9,
            height in 1_usize..7,
            back in -6_i8..3,
        ) {
            let points: Vec<_> = points
                .iter()
                .map(|p| [f32::from(p.0) / 2.0, f32::from(p.1) / 8.0, f32::from(p.2) / 8.0, 0.0])
                .collect();
            let mut projection = PLAIN;
            projection[2][3] = f64::from(back) / 2.0;
            for axis in [DepthAxis::VelodyneX, DepthAxis::CameraZ] {
                prop_assert_eq!(
                    velodyne_depth(&points, &projection, width, height, axis),
                    step_by_step(&points, &projection, (width, height), axis)
                );
            }
        }

        #[test]
        fn any_bytes_are_a_scan_or_refused(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
            match parse_velodyne(&bytes) {
                Ok(points) => {
                    prop_assert_eq!(16 * points.len(), bytes.len());
                    for axis in [DepthAxis::VelodyneX, DepthAxis::CameraZ] {
                        let depth_m = velodyne_depth(&points, &PLAIN, 12, 9, axis);
                        prop_assert!(depth_m.iter().all(|d| *d >= 0.0));
                    }
                }
                Err(_) => prop_assert!(bytes.is_empty() || bytes.len() % 16 != 0),
            }
        }

        /// Away from the image's side columns a pixel holds the nearest of its points,
        /// whatever their order.
        #[test]
        fn inner_pixels_do_not_depend_on_point_order(
            mut points in prop::collection::vec((1.0_f32..50.0, -20.0_f32..20.0, -20.0_f32..20.0), 1..200)
        ) {
            let image = |points: &[(f32, f32, f32)]| {
                let points: Vec<_> = points.iter().map(|p| [p.0, p.1, p.2, 0.0]).collect();
                velodyne_depth(&points, &PLAIN, 12, 9, DepthAxis::VelodyneX)
            };
            let forward = image(&points);
            points.reverse();
            let backward = image(&points);
            for (row_a, row_b) in forward.chunks(12).zip(backward.chunks(12)) {
                prop_assert_eq!(&row_a[1..11], &row_b[1..11]);
            }
        }
    }
}
