//! Depth images from Velodyne scans (PROTOCOL 3.5), reproducing the evaluation that all
//! published Eigen-split figures use, including its quirks.
//!
//! Two of its habits are wrong and kept for comparison: the depth it stores is the distance
//! along the *scanner's* x axis rather than the camera's optical axis
//! ([`DepthAxis::CameraZ`] is the right one), and its search for points falling on one pixel
//! also merges the last pixel of a row with the first of the next.

use crate::calibration::{CamToCam, VeloToCam};
use crate::frustum::{BLOCK, Frustum};

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
    /// Rows of something else.
    #[error(
        "a Velodyne scan is rows of x, y, z and reflectance in 32-bit floats, but in {percent} % of the \
         rows the fourth number is no reflectance (0 to 1, or to 255); it has another number of columns or \
         another type: save points[:, :4].astype('<f4')"
    )]
    NoReflectance {
        /// Rows, of those looked at.
        percent: u64,
    },
}

/// Tells scans from rows of another width or type, in which the fourth number is now a coordinate, now
/// half of a 64-bit float: a third or more of them are negative or far too large.
#[derive(Debug, Clone, Copy, Default)]
struct Reflectance {
    rows: u64,
    odd: u64,
}

impl Reflectance {
    #[inline(always)]
    fn look_at(&mut self, &[x, y, z, reflectance]: &[f32; 4]) {
        // Rows of NaN are how some programs mark what was not measured.
        let measured = x.is_finite() & y.is_finite() & z.is_finite();
        self.rows += u64::from(measured);
        self.odd += u64::from(measured & !(0.0..=255.0).contains(&reflectance));
    }

    /// One row in a hundred may be damaged.
    fn check(self) -> Result<(), ScanError> {
        match self.odd * 100 > self.rows {
            true => Err(ScanError::NoReflectance {
                percent: self.odd * 100 / self.rows,
            }),
            false => Ok(()),
        }
    }
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
/// The bytes are not a whole, positive number of points, or have no reflectance.
pub fn parse_velodyne(bytes: &[u8]) -> Result<Vec<[f32; 4]>, ScanError> {
    check_length(bytes.len())?;
    let points: Vec<_> = bytes.as_chunks().0.iter().map(point).collect();
    let mut reflectance = Reflectance::default();
    points.iter().for_each(|point| reflectance.look_at(point));
    reflectance.check()?;
    Ok(points)
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

/// The depth image of a scan: see [`ScanDepth`], which takes a scan piece by piece.
pub fn velodyne_depth(
    points: &[[f32; 4]],
    projection: &[[f64; 4]; 3],
    width: usize,
    height: usize,
    axis: DepthAxis,
) -> Vec<f32> {
    let mut scan = ScanDepth::new(projection, width, height, [axis]);
    scan.add_points(points);
    let [depth_m] = scan.images();
    depth_m
}

/// Depth images of a scan that is given piece by piece, so that it is projected while it is
/// in the caches and never needs to be in memory as a whole.
///
/// An image has `width * height` values in metres, row by row, 0 where nothing was measured. Points
/// behind the scanner (x < 0) are dropped; pixels are 1-based in the projection and rounded half to
/// even; of several points on a pixel the nearest stays. Negative depths become 0.
#[derive(Debug, Clone)]
pub struct ScanDepth<const N: usize> {
    projection: [[f64; 4]; 3],
    frustum: Frustum,
    width: usize,
    height: usize,
    images: [Image; N],
    /// Hits of the first and the last column, where points of two pixels share a search key:
    /// pixel and a value for each image.
    sides: Vec<(usize, [f32; N])>,
    /// Bytes taken, and those of them that are the beginning of a point.
    bytes: usize,
    begun: [u8; POINT],
    /// Of the first point of each block and of those in no block.
    reflectance: Reflectance,
}

#[derive(Debug, Clone)]
struct Image {
    axis: DepthAxis,
    depth_m: Vec<f32>,
    /// Inner pixels that a point without a positive depth fell on: nothing is nearer than that.
    blank: Vec<usize>,
}

/// Bytes of a point.
const POINT: usize = 16;

/// Where a point falls is a number, so that many are found at once: that of its pixel, and these.
const SIDE: f64 = 0.5;
const OUTSIDE: f64 = -1.0;

impl<const N: usize> ScanDepth<N> {
    /// No points yet; `axes` says what the values of each image are, and `projection` comes from
    /// [`velodyne_projection`].
    pub fn new(
        projection: &[[f64; 4]; 3],
        width: usize,
        height: usize,
        axes: [DepthAxis; N],
    ) -> Self {
        Self {
            projection: *projection,
            frustum: Frustum::new(projection, width, height),
            width,
            height,
            images: axes.map(|axis| Image {
                axis,
                depth_m: vec![0.0; width * height],
                blank: Vec::new(),
            }),
            sides: Vec::new(),
            bytes: 0,
            begun: [0; POINT],
            reflectance: Reflectance::default(),
        }
    }

    /// Takes the next bytes of the scan, in the layout of [`parse_velodyne`]. Pieces may end
    /// anywhere; whole numbers of points are fastest.
    pub fn add(&mut self, mut bytes: &[u8]) {
        let begun = self.bytes % POINT;
        self.bytes += bytes.len();
        if begun > 0 {
            let (end, rest) = bytes.split_at(bytes.len().min(POINT - begun));
            self.begun[begun..begun + end.len()].copy_from_slice(end);
            if begun + end.len() < POINT {
                return;
            }
            let point = point(&self.begun);
            self.reflectance.look_at(&point);
            self.add_points(&[point]);
            bytes = rest;
        }
        let (points, rest) = bytes.as_chunks::<POINT>();
        let (blocks, last) = points.as_chunks::<BLOCK>();
        for block in blocks {
            self.reflectance.look_at(&point(&block[0]));
            // Half of the blocks lie behind the scanner: one number of each point tells.
            let front = |seen, at: &[u8; POINT]| seen | (point(at)[0] >= 0.0);
            if !block.iter().fold(false, front) {
                continue;
            }
            let mut points = [[0.0; 4]; BLOCK];
            for (to, from) in points.iter_mut().zip(block) {
                *to = point(from);
            }
            self.add_block(&points);
        }
        let last: Vec<_> = last.iter().map(point).collect();
        last.iter()
            .for_each(|point| self.reflectance.look_at(point));
        self.add_points(&last);
        self.begun[..rest.len()].copy_from_slice(rest);
    }

    /// The images in the order of their axes.
    ///
    /// # Errors
    /// The bytes added were not a whole, positive number of points, or had no reflectance.
    pub fn finish(self) -> Result<[Vec<f32>; N], ScanError> {
        check_length(self.bytes)?;
        self.reflectance.check()?;
        Ok(self.images())
    }

    fn add_points(&mut self, points: &[[f32; 4]]) {
        let (blocks, rest) = points.as_chunks::<BLOCK>();
        for block in blocks {
            self.add_block(block);
        }
        if !rest.is_empty() {
            // The rest of the block is filled with points that are dropped.
            let mut block = [[-1.0; 4]; BLOCK];
            block[..rest.len()].copy_from_slice(rest);
            self.add_block(&block);
        }
    }

    /// A scan is in the order of its sweep, so most blocks lie behind the scanner or beside the image
    /// as a whole; these cost little.
    #[inline(always)]
    fn add_block(&mut self, points: &[[f32; 4]; BLOCK]) {
        let mut axes = [[0.0; BLOCK]; 3];
        let mut front = false;
        for (at, point) in points.iter().enumerate() {
            (axes[0][at], axes[1][at], axes[2][at]) = (point[0], point[1], point[2]);
            front |= point[0] >= 0.0;
        }
        if !front {
            return;
        }
        let shown = self.frustum.may_show(&axes);
        if shown != [false; BLOCK] {
            self.project(&axes, &shown);
        }
    }

    /// Projects a block; written so that everything up to the pixels is done for many points at once.
    fn project(&mut self, [xs, ys, zs]: &[[f32; BLOCK]; 3], shown: &[bool; BLOCK]) {
        let [first, second, third] = self.projection;
        let (columns, rows) = (self.width as f64, self.height as f64);
        let mut places = [0.0; BLOCK];
        let mut ws = [0.0; BLOCK];
        for at in 0..BLOCK {
            let (x, y, z) = (f64::from(xs[at]), f64::from(ys[at]), f64::from(zs[at]));
            let u = first[0] * x + first[1] * y + first[2] * z + first[3];
            let v = second[0] * x + second[1] * y + second[2] * z + second[3];
            let w = third[0] * x + third[1] * y + third[2] * z + third[3];
            let (column, row) = (half_to_even(u / w), half_to_even(v / w));
            let inside = (column >= 1.0) & (column <= columns) & (row >= 1.0) & (row <= rows);
            let inner = (column > 1.0) & (column < columns);
            let pixel = (row - 1.0) * columns + (column - 1.0);
            let place = if inner { pixel } else { pixel + SIDE };
            places[at] = if inside { place } else { OUTSIDE };
            ws[at] = w;
        }
        for at in 0..BLOCK {
            if shown[at] & (places[at] >= 0.0) {
                self.hit(places[at], xs[at], ws[at] as f32);
            }
        }
    }

    /// `place` is the number of a pixel, plus [`SIDE`] in the first and the last column.
    #[inline(always)]
    fn hit(&mut self, place: f64, velodyne_x_m: f32, camera_z_m: f32) {
        let pixel = place as usize;
        // Rounding keeps the order, so the nearest of the rounded is the rounded nearest.
        let value = |axis| match axis {
            DepthAxis::VelodyneX => velodyne_x_m,
            DepthAxis::CameraZ => camera_z_m,
        };
        if place != pixel as f64 {
            let values = std::array::from_fn(|at| value(self.images[at].axis));
            self.sides.push((pixel, values));
            return;
        }
        for image in &mut self.images {
            let value = value(image.axis);
            let nearest = &mut image.depth_m[pixel];
            if value > 0.0 {
                // Positive numbers are ordered as their bits are; less one, 0 is the largest.
                let order = |depth_m: f32| depth_m.to_bits().wrapping_sub(1);
                let least = order(*nearest).min(order(value));
                *nearest = f32::from_bits(least.wrapping_add(1));
            } else {
                image.blank.push(pixel);
            }
        }
    }

    fn images(mut self) -> [Vec<f32>; N] {
        for image in &mut self.images {
            for pixel in image.blank.drain(..) {
                image.depth_m[pixel] = 0.0;
            }
        }
        // Last in file order stays, then the first pixel of a key is given the nearest of the key.
        let mut set = |pixel: usize, values: [f32; N]| {
            for (image, value) in self.images.iter_mut().zip(values) {
                image.depth_m[pixel] = value.max(0.0);
            }
        };
        for &(pixel, values) in &self.sides {
            set(pixel, values);
        }
        let width = self.width;
        let key = |(pixel, _): &(usize, _)| pixel / width * (width - 1) + pixel % width;
        self.sides.sort_by_key(key);
        let groups = self.sides.chunk_by(|a, b| key(a) == key(b));
        for group in groups.filter(|group| group.len() > 1) {
            let nearest = group.iter().fold([f32::INFINITY; N], |nearest, hit| {
                std::array::from_fn(|at| nearest[at].min(hit.1[at]))
            });
            set(group[0].0, nearest);
        }
        self.images.map(|image| image.depth_m)
    }
}

fn check_length(bytes: usize) -> Result<(), ScanError> {
    match bytes {
        0 => Err(ScanError::Empty),
        _ if bytes.is_multiple_of(POINT) => Ok(()),
        _ => Err(ScanError::Truncated { bytes }),
    }
}

#[inline]
fn point(bytes: &[u8; POINT]) -> [f32; 4] {
    let (numbers, _) = bytes.as_chunks::<4>();
    std::array::from_fn(|at| f32::from_le_bytes(numbers[at]))
}

/// Rounds half to even. Exact below 2^51 in size, and what is larger stays larger than any image;
/// without SSE4.1 the standard method is a library call.
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
    fn a_scan_in_pieces_is_the_whole_scan() {
        let cam = CamToCam::parse(CAM).unwrap();
        let projection = velodyne_projection(&cam, &VeloToCam::parse(VELO).unwrap());
        let points = &closed_form_cloud()[..2005];
        let bytes: Vec<u8> = points
            .as_flattened()
            .iter()
            .flat_map(|n| n.to_le_bytes())
            .collect();
        let axes = [DepthAxis::VelodyneX, DepthAxis::CameraZ];
        let whole = axes.map(|axis| velodyne_depth(points, &projection, 1242, 375, axis));
        for size in [1, 7, 16, 100, 256, 4099, bytes.len()] {
            let mut scan = ScanDepth::new(&projection, 1242, 375, axes);
            for piece in bytes.chunks(size) {
                scan.add(piece);
            }
            assert_eq!(scan.finish().unwrap(), whole, "pieces of {size} bytes");
        }
        let mut cut = ScanDepth::new(&projection, 1242, 375, axes);
        cut.add(&bytes[..17]);
        assert_eq!(cut.finish(), Err(ScanError::Truncated { bytes: 17 }));
        let none = ScanDepth::new(&projection, 1242, 375, axes);
        assert_eq!(none.finish(), Err(ScanError::Empty));
    }

    /// Points around the scanner in rows of `columns` numbers: x, y, z, reflectance, then zeros.
    fn around(columns: usize) -> Vec<[f64; 5]> {
        let at = |i: u32| {
            let step = f64::from(i % 97) - 48.0;
            let (x, y, z) = (
                f64::from(i % 61) - 20.3,
                step / 2.0,
                f64::from(i % 13) / 5.0 - 1.9,
            );
            let row = [x, y, z, f64::from(i % 100) / 100.0, 0.0];
            std::array::from_fn(|at| if at < columns { row[at] } else { 0.0 })
        };
        (0..4000).map(at).collect()
    }

    #[test]
    fn rows_of_another_width_or_type_are_no_scan() {
        let single = |columns: usize| -> Vec<u8> {
            let rows = around(columns).into_iter();
            rows.flat_map(|row| row[..columns].to_vec())
                .flat_map(|number| (number as f32).to_le_bytes())
                .collect()
        };
        let double: Vec<u8> = around(4)
            .into_iter()
            .flat_map(|row| row[..4].to_vec())
            .flat_map(f64::to_le_bytes)
            .collect();
        let finish = |bytes: &[u8]| {
            let mut scan = ScanDepth::new(&PLAIN, 10, 8, [DepthAxis::CameraZ]);
            scan.add(bytes);
            scan.finish()
        };
        let intensities: Vec<u8> = {
            // Intensities up to 255, and a third of the rows not measured.
            let mut points = around(4);
            points.iter_mut().for_each(|row| row[3] *= 250.0);
            points
                .iter_mut()
                .step_by(3)
                .for_each(|row| *row = [f64::NAN; 5]);
            let numbers = points.into_iter().flat_map(|row| row[..4].to_vec());
            numbers
                .flat_map(|number| (number as f32).to_le_bytes())
                .collect()
        };
        for good in [single(4), intensities] {
            assert!(finish(&good).is_ok());
            assert!(parse_velodyne(&good).is_ok());
        }
        for bad in [single(3), single(5), double] {
            assert!(matches!(
                finish(&bad),
                Err(ScanError::NoReflectance { percent: 20.. })
            ));
            let error = parse_velodyne(&bad).unwrap_err();
            assert!(error.to_string().contains("points[:, :4]"), "{error}");
        }
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
            velodyne_depth(
                &[[1.0_f32, 0.45, 0.35, 0.0]],
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
        // Recipe: make_golden.py geometry/scan.
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

    fn odd_number() -> impl Strategy<Value = f32> {
        prop_oneof![
            4 => -3.0_f32..3.0,
            2 => (-3_i8..4).prop_map(f32::from),
            2 => (-149_i32..128, any::<bool>()).prop_map(|(power, negative)| {
                let size = 2.0_f64.powi(power) as f32;
                if negative { -size } else { size }
            }),
            1 => any::<f32>(),
        ]
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

        /// Points within a few roundings of the edges of the image, near and far, in front of the camera
        /// and behind it, where passing one over too early would show.
        #[test]
        fn points_on_the_edges_of_an_image_are_not_lost(
            points in prop::collection::vec(
                (0..4_usize, 0.0_f64..1.0, -26_i32..20, any::<bool>(), prop::array::uniform3(-2_i32..3)),
                1..60,
            ),
            (width, height) in (1_usize..2000, 1_usize..500),
            tilt in prop::array::uniform3(-0.02_f64..0.02),
        ) {
            let (focal_px, w, h) = (721.5377, width as f64, height as f64);
            let (cx, cy) = (0.49 * w, 0.46 * h);
            // Camera axes from the scanner's by a small rotation and shift, as KITTI's rig has them.
            let projection = [
                [cx, -focal_px, focal_px * tilt[0], 44.9 - 0.27 * cx],
                [cy, focal_px * tilt[1], -focal_px, -0.22 - 0.27 * cy],
                [1.0, tilt[2], tilt[0], -0.27],
            ];
            let points: Vec<[f32; 4]> = points
                .into_iter()
                .filter_map(|(edge, along, power, behind, ulps)| {
                    // The ray through a place on the edge, by Cramer's rule in y and z for a given x.
                    let (u, v) = match edge {
                        0 => (0.5, 0.5 + along * h),
                        1 => (w + 0.5, 0.5 + along * h),
                        2 => (0.5 + along * w, 0.5),
                        _ => (0.5 + along * w, h + 0.5),
                    };
                    let x = if behind { 0.2 * along } else { 0.27 + 2.0_f64.powi(power) };
                    let x = f64::from(x as f32);
                    let [a, b] = [(u, 0), (v, 1)].map(|(place, row)| {
                        std::array::from_fn::<f64, 4, _>(|k| projection[row][k] - place * projection[2][k])
                    });
                    let (p, q) = (-(a[0] * x + a[3]), -(b[0] * x + b[3]));
                    let scale = a[1] * b[2] - a[2] * b[1];
                    let (y, z) = ((p * b[2] - q * a[2]) / scale, (a[1] * q - b[1] * p) / scale);
                    let near = |number: f64, ulps: i32| {
                        let number = number as f32;
                        f32::from_bits(number.to_bits().saturating_add_signed(ulps))
                    };
                    let point = [near(x, ulps[0]), near(y, ulps[1]), near(z, ulps[2]), 0.0];
                    point.iter().all(|n| n.is_finite()).then_some(point)
                })
                .collect();
            for axis in [DepthAxis::VelodyneX, DepthAxis::CameraZ] {
                prop_assert_eq!(
                    velodyne_depth(&points, &projection, width, height, axis),
                    step_by_step(&points, &projection, (width, height), axis)
                );
            }
        }

        /// Coefficients and coordinates of all sizes, infinite and no numbers among them.
        #[test]
        fn images_equal_the_definition_for_any_numbers(
            points in prop::collection::vec(prop::array::uniform4(odd_number()), 0..40),
            numbers in prop::array::uniform12(odd_number()),
        ) {
            let projection = [0, 4, 8].map(|at| [0, 1, 2, 3].map(|k| f64::from(numbers[at + k])));
            for axis in [DepthAxis::VelodyneX, DepthAxis::CameraZ] {
                prop_assert_eq!(
                    velodyne_depth(&points, &projection, 5, 4, axis),
                    step_by_step(&points, &projection, (5, 4), axis)
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
                Err(ScanError::NoReflectance { percent }) => prop_assert!((1..=100).contains(&percent)),
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
