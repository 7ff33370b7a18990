//! A map of depth as a coloured point cloud, in PLY.
//!
//! A pixel (u, v) of depth z lies at x = (u - cx) z / f, y = (v - cy) z / f: x to the right, y down, z away from
//! the camera, in metres. The principal point is taken to be the image's centre. Pixels without depth, and those
//! beyond a limit, have no point.

use image::RgbImage;
use strat_store::raster::Plane;

/// The bytes of a PLY file (binary, little endian). `focal` is in image widths; `to_m` is the largest depth.
pub(super) fn encode(
    depth_m: &Plane,
    image: &RgbImage,
    focal: f64,
    to_m: f64,
    source: &str,
) -> Vec<u8> {
    let (width, height) = (depth_m.width as f64, depth_m.height as f64);
    // A map of the network's size has other pixels than its image, and they need not be square.
    let (fx, fy) = (
        focal * width,
        focal * f64::from(image.width()) / f64::from(image.height()) * height,
    );
    let (cx, cy) = ((width - 1.0) / 2.0, (height - 1.0) / 2.0);
    let nearest = |place: usize, of: f64, size: u32| {
        let place = (place as f64 + 0.5) * f64::from(size) / of;
        (place as u32).min(size.saturating_sub(1))
    };
    let mut points: Vec<u8> = Vec::new();
    let mut count = 0_u64;
    for (index, &z) in depth_m.data.iter().enumerate() {
        let z = f64::from(z);
        if !(z > 0.0 && z <= to_m) {
            continue;
        }
        let (column, row) = (index % depth_m.width, index / depth_m.width);
        let (x, y) = ((column as f64 - cx) * z / fx, (row as f64 - cy) * z / fy);
        for value in [x, y, z] {
            points.extend((value as f32).to_le_bytes());
        }
        let pixel = image.get_pixel(
            nearest(column, width, image.width()),
            nearest(row, height, image.height()),
        );
        points.extend(pixel.0);
        count += 1;
    }
    let source: String = source
        .chars()
        .filter(|letter| !letter.is_control())
        .collect();
    let mut bytes = format!(
        "ply\nformat binary_little_endian 1.0\n\
         comment {source}\n\
         comment metres; x right, y down, z away from the camera; principal point in the centre\n\
         element vertex {count}\n\
         property float x\nproperty float y\nproperty float z\n\
         property uchar red\nproperty uchar green\nproperty uchar blue\n\
         end_header\n"
    )
    .into_bytes();
    bytes.extend(points);
    bytes
}

#[cfg(test)]
mod tests {
    use image::Rgb;

    use super::*;

    /// By hand: 3 x 1 pixels, f = 2 px, centre 1: at 10 m the left pixel lies 5 m to the left.
    #[test]
    fn points_lie_where_they_are_seen() {
        let map = Plane::new(3, 1, vec![10.0, 0.0, 90.0]).unwrap();
        let image = RgbImage::from_fn(3, 1, |x, _| Rgb([x as u8, 7, 9]));
        let bytes = encode(&map, &image, 2.0 / 3.0, 80.0, "model\nx");
        let text = String::from_utf8_lossy(&bytes);
        assert!(
            text.contains("comment modelx\n") && text.contains("element vertex 1\n"),
            "{text}"
        );
        let points = &bytes[bytes.len() - 15..];
        let value = |at: usize| f32::from_le_bytes(points[at..at + 4].try_into().unwrap());
        assert_eq!([value(0), value(4), value(8)], [-5.0, 0.0, 10.0]);
        assert_eq!(points[12..], [0, 7, 9]);
        // With twice the columns, each point lies as far out as before.
        let wide = Plane::new(6, 1, vec![10.0, 0.0, 0.0, 0.0, 0.0, 0.0]).unwrap();
        let bytes = encode(&wide, &image, 2.0 / 3.0, 80.0, "");
        let points = &bytes[bytes.len() - 15..];
        let x = f32::from_le_bytes(points[..4].try_into().unwrap());
        assert_eq!(x, -2.5 * 10.0 / 4.0);
    }
}
