//! `calib_cam_to_cam.txt` and `calib_velo_to_cam.txt`.
#![no_main]

mod damage;

use libfuzzer_sys::fuzz_target;
use strat_geometry::{CamToCam, VeloToCam, velodyne_projection};

const CAM: &str = "S_rect_02: 1.242000e+03 3.750000e+02
R_rect_00: 0.99992 0.00984 -0.00745 -0.00987 0.99994 -0.00428 0.00740 0.00435 0.99996
P_rect_02: 721.5377 0 609.5593 44.85728 0 721.5377 172.854 0.2163791 0 0 1 0.002745884
P_rect_03: 721.5377 0 609.5593 -339.5242 0 721.5377 172.854 2.199936 0 0 1 0.002729905
";
const VELO: &str = "R: 0 -1 0 0 0 -1 1 0 0\nT: -0.004 -0.076 -0.272\n";

fuzz_target!(|data: &[u8]| {
    let cam = damage::damaged(CAM.as_bytes(), data);
    let velo = damage::damaged(VELO.as_bytes(), data);
    let cam = CamToCam::parse(&String::from_utf8_lossy(&cam));
    let velo = VeloToCam::parse(&String::from_utf8_lossy(&velo));
    if let Ok(cam) = &cam {
        assert!(cam.width > 0 && cam.height > 0 && cam.focal_px() > 0.0);
        assert!(cam.baseline_m() > 0.0 && cam.baseline_m().is_finite());
        if let Ok(velo) = &velo {
            velodyne_projection(cam, velo);
        }
    }
    for error in [cam.err(), velo.err()].into_iter().flatten() {
        assert!(error.to_string().len() < 400);
    }
});
