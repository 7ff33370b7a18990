//! Depth images from Velodyne scans (PROTOCOL 3.5), reproducing the evaluation that all
//! published Eigen-split figures use, including its quirks.
//!
//! Two of its habits are wrong and kept for comparison: the depth it stores is the distance
//! along the *scanner's* x axis rather than the camera's optical axis
//! ([`DepthAxis::CameraZ`] is the right one), and its search for points falling on one pixel
//! also merges the last pixel of a row with the first of the next.

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
        .map(|p| std::array::from_fn(|i| number(p, i)))
        .collect())
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
pub fn velodyne_depth(
    points: &[[f32; 4]],
    projection: &[[f64; 4]; 3],
    width: usize,
    height: usize,
    axis: DepthAxis,
) -> Vec<f32> {
    let mut depth_m = vec![0.0_f64; width * height];
    if depth_m.is_empty() {
        return Vec::new();
    }
    // Per collision key: pixel of the first point, points seen, nearest of them. Keys run
    // from -1 (the first pixel of the image) to height * (width - 1) - 1.
    let mut groups = vec![Group::default(); height * (width - 1) + 1];
    for &[x, y, z, _] in points {
        if x.is_nan() || x < 0.0 {
            continue;
        }
        let point = [f64::from(x), f64::from(y), f64::from(z), 1.0];
        let [u, v, w] = projection
            .map(|row| row[0] * point[0] + row[1] * point[1] + row[2] * point[2] + row[3]);
        let column = (u / w).round_ties_even() - 1.0;
        let row = (v / w).round_ties_even() - 1.0;
        if !(column >= 0.0 && row >= 0.0 && column < width as f64 && row < height as f64) {
            continue;
        }
        let (column, row) = (column as usize, row as usize);
        let pixel = row * width + column;
        let value = match axis {
            DepthAxis::VelodyneX => point[0],
            DepthAxis::CameraZ => w,
        };
        depth_m[pixel] = value;
        groups[row * (width - 1) + column].add(pixel, value);
    }
    for group in groups.iter().filter(|group| group.points > 1) {
        depth_m[group.first_pixel] = group.nearest_m;
    }
    depth_m
        .into_iter()
        .map(|depth_m| if depth_m < 0.0 { 0.0 } else { depth_m as f32 })
        .collect()
}

#[derive(Clone, Default)]
struct Group {
    first_pixel: usize,
    points: u32,
    nearest_m: f64,
}

impl Group {
    fn add(&mut self, pixel: usize, depth_m: f64) {
        if self.points == 0 {
            self.first_pixel = pixel;
            self.nearest_m = depth_m;
        }
        self.nearest_m = self.nearest_m.min(depth_m);
        self.points += 1;
    }
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
            [10.0, 0.0, 0.0, 0.5],
            [20.0, 0.0, 0.0, 0.5],
            [-5.0, 0.0, 0.0, 0.1],
        ];
        let depth = velodyne_depth(&points, &PLAIN, 9, 8, DepthAxis::VelodyneX);
        // 5.5 -> 6 and 4.5 -> 4, minus the one of 1-based pixels: row 3, column 5
        assert_eq!(depth[3 * 9 + 5], 10.0);
        assert_eq!(depth.iter().filter(|d| **d > 0.0).count(), 1);
        let swapped = [points[1], points[0]];
        assert_eq!(
            velodyne_depth(&swapped, &PLAIN, 9, 8, DepthAxis::VelodyneX),
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
        let depth = velodyne_depth(&points, &PLAIN, 3, 2, DepthAxis::VelodyneX);
        assert_eq!(depth, [0.0, 0.0, 8.0, 8.0, 0.0, 0.0]);
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
            velodyne_depth(&points, &PLAIN, 9, 8, DepthAxis::VelodyneX)
                .iter()
                .all(|d| *d == 0.0)
        );
        assert!(velodyne_depth(&points, &PLAIN, 0, 8, DepthAxis::VelodyneX).is_empty());
        assert_eq!(
            velodyne_depth(&[[1.0, 0.45, 0.35, 0.0]], &PLAIN, 1, 1, DepthAxis::CameraZ),
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
