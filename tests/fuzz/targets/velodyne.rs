//! Velodyne scans and the depth images made of them.
#![no_main]

use libfuzzer_sys::fuzz_target;
use strat_geometry::{DepthAxis, ScanError, parse_velodyne, velodyne_depth};

fuzz_target!(|data: &[u8]| {
    // Two bytes of image size, then a projection of 12 numbers, then the scan.
    let [width, height, rest @ ..] = data else {
        return;
    };
    let (width, height) = (usize::from(*width), usize::from(*height));
    let Some((matrix, scan)) = rest.split_at_checked(48) else {
        return;
    };
    let mut numbers = matrix
        .as_chunks::<4>()
        .0
        .iter()
        .map(|bytes| f64::from(f32::from_le_bytes(*bytes)));
    let projection = [[(); 4]; 3].map(|row| row.map(|()| numbers.next().unwrap_or_default()));
    let points = match parse_velodyne(scan) {
        Ok(points) => points,
        Err(ScanError::NoReflectance { .. }) => return,
        Err(_) => {
            assert!(scan.is_empty() || scan.len() % 16 != 0);
            return;
        }
    };
    for axis in [DepthAxis::VelodyneX, DepthAxis::CameraZ] {
        let depth_m = velodyne_depth(&points, &projection, width, height, axis);
        assert_eq!(depth_m.len(), width * height);
        assert!(depth_m.iter().all(|depth| *depth >= 0.0));
    }
});
