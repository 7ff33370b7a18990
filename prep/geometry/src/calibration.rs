//! The two calibration files of a recording day (PROTOCOL 1.1).
//!
//! A file is lines of `KEY: number number ...`, matrices row by row. Lines whose values do
//! not all read as finite numbers are passed over: `calib_time` is one by nature, and the
//! public stereo 2015 calibration has a line with a damaged number. A needed key that is
//! missing or damaged is an error.

use std::collections::HashMap;

/// Why a calibration text is of no use.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CalibrationError {
    /// A needed line is not there.
    #[error(
        "line `{key}: ...` ({numbers} numbers) is missing, so this is not a complete {file} file"
    )]
    Missing {
        /// The key looked for.
        key: &'static str,
        /// How many numbers it should have.
        numbers: usize,
        /// Name of the kind of file.
        file: &'static str,
    },
    /// A needed line is there but cannot be used.
    #[error("line {line}: `{key}` should have {numbers} finite numbers, but reads `{found}`")]
    Damaged {
        /// 1-based line number.
        line: usize,
        /// The key looked for.
        key: &'static str,
        /// How many numbers it should have.
        numbers: usize,
        /// The start of what is there.
        found: String,
    },
    /// The numbers can be read but describe no stereo camera.
    #[error("{0}")]
    Impossible(String),
}

/// What is needed of `calib_cam_to_cam.txt`: the rectified colour cameras 2 (left) and 3 (right).
#[derive(Debug, Clone, PartialEq)]
pub struct CamToCam {
    /// Width in pixels of the rectified left image (`S_rect_02`).
    pub width: u32,
    /// Height in pixels of the rectified left image (`S_rect_02`).
    pub height: u32,
    /// Rotation from camera 0 to the rectified frame (`R_rect_00`).
    pub r_rect_00: [[f64; 3]; 3],
    /// Projection from the rectified frame to left pixels (`P_rect_02`).
    pub p_rect_02: [[f64; 4]; 3],
    /// Projection from the rectified frame to right pixels (`P_rect_03`).
    pub p_rect_03: [[f64; 4]; 3],
}

/// What is needed of `calib_velo_to_cam.txt`: from Velodyne coordinates to camera 0.
#[derive(Debug, Clone, PartialEq)]
pub struct VeloToCam {
    /// Rotation (`R`).
    pub rotation: [[f64; 3]; 3],
    /// Translation in metres (`T`).
    pub translation: [f64; 3],
}

impl CamToCam {
    /// Reads the text of a `calib_cam_to_cam` file.
    ///
    /// # Errors
    /// A needed key is missing or damaged, or the cameras are no left-right pair.
    pub fn parse(text: &str) -> Result<Self, CalibrationError> {
        let lines = Lines::of(text, "calib_cam_to_cam");
        let [width, height] = lines.numbers("S_rect_02")?;
        let calibration = Self {
            width: pixels("width", width)?,
            height: pixels("height", height)?,
            r_rect_00: rows(lines.numbers::<9>("R_rect_00")?),
            p_rect_02: rows(lines.numbers::<12>("P_rect_02")?),
            p_rect_03: rows(lines.numbers::<12>("P_rect_03")?),
        };
        for (key, projection) in [
            ("P_rect_02", &calibration.p_rect_02),
            ("P_rect_03", &calibration.p_rect_03),
        ] {
            if projection[0][0] <= 0.0 {
                return Err(CalibrationError::Impossible(format!(
                    "`{key}` states a focal length of {} px; it must be positive",
                    projection[0][0]
                )));
            }
        }
        let baseline_m = calibration.baseline_m();
        if !(baseline_m.is_finite() && baseline_m > 0.0) {
            return Err(CalibrationError::Impossible(format!(
                "`P_rect_02` and `P_rect_03` put camera 3 at {baseline_m} m to the right of camera 2; \
                 it must be a positive distance"
            )));
        }
        Ok(calibration)
    }

    /// Focal length in pixels of the left image.
    pub fn focal_px(&self) -> f64 {
        self.p_rect_02[0][0]
    }

    /// Distance in metres between the left and the right camera.
    pub fn baseline_m(&self) -> f64 {
        let offset = |p: &[[f64; 4]; 3]| p[0][3] / -p[0][0];
        offset(&self.p_rect_03) - offset(&self.p_rect_02)
    }
}

impl VeloToCam {
    /// Reads the text of a `calib_velo_to_cam` file.
    ///
    /// # Errors
    /// `R` or `T` is missing or damaged.
    pub fn parse(text: &str) -> Result<Self, CalibrationError> {
        let lines = Lines::of(text, "calib_velo_to_cam");
        Ok(Self {
            rotation: rows(lines.numbers::<9>("R")?),
            translation: lines.numbers("T")?,
        })
    }
}

/// A calibration text by key: line number and the text behind the first colon.
struct Lines<'a> {
    file: &'static str,
    by_key: HashMap<&'a str, Vec<(usize, &'a str)>>,
}

impl<'a> Lines<'a> {
    fn of(text: &'a str, file: &'static str) -> Self {
        let mut by_key: HashMap<_, Vec<_>> = HashMap::new();
        for (index, line) in text.lines().enumerate() {
            if let Some((key, values)) = line.split_once(':') {
                by_key
                    .entry(key.trim())
                    .or_default()
                    .push((index + 1, values.trim()));
            }
        }
        Self { file, by_key }
    }

    /// The `N` numbers of a key; the last readable line wins where a key is repeated.
    fn numbers<const N: usize>(&self, key: &'static str) -> Result<[f64; N], CalibrationError> {
        let found = self.by_key.get(key).map_or(&[][..], Vec::as_slice);
        if let Some(numbers) = found
            .iter()
            .rev()
            .find_map(|(_, values)| finite_numbers(values))
        {
            return Ok(numbers);
        }
        Err(match found.last() {
            None => CalibrationError::Missing {
                key,
                numbers: N,
                file: self.file,
            },
            Some((line, values)) => CalibrationError::Damaged {
                line: *line,
                key,
                numbers: N,
                found: values.chars().take(40).collect(),
            },
        })
    }
}

fn finite_numbers<const N: usize>(values: &str) -> Option<[f64; N]> {
    let numbers: Option<Vec<f64>> = values
        .split_whitespace()
        .map(|word| word.parse().ok().filter(|n: &f64| n.is_finite()))
        .collect();
    numbers?.try_into().ok()
}

fn rows<const N: usize, const R: usize, const C: usize>(numbers: [f64; N]) -> [[f64; C]; R] {
    const { assert!(N == R * C) }
    std::array::from_fn(|row| std::array::from_fn(|column| numbers[row * C + column]))
}

fn pixels(what: &str, number: f64) -> Result<u32, CalibrationError> {
    if number.fract() == 0.0 && (1.0..=65_535.0).contains(&number) {
        return Ok(number as u32);
    }
    Err(CalibrationError::Impossible(format!(
        "`S_rect_02` states an image {what} of {number} pixels"
    )))
}

#[cfg(test)]
pub(crate) mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Values of 2011_09_26 as PROTOCOL 1.1 tabulates them (rotation of camera 0 rounded by us).
    pub(crate) const CAM: &str = "calib_time: 09-Jan-2012 13:57:47\r
corner_dist: 9.950000e-02
S_rect_02: 1.242000e+03 3.750000e+02
R_rect_00: 0.99992 0.00984 -0.00745 -0.00987 0.99994 -0.00428 0.00740 0.00435 0.99996
P_rect_00: 1,1+02 0 609.5593 0 0 721.5377 172.854 0 0 0 1 0
P_rect_02: 721.5377 0 609.5593 44.85728 0 721.5377 172.854 0.2163791 0 0 1 0.002745884
P_rect_03: 721.5377 0 609.5593 -339.5242 0 721.5377 172.854 2.199936 0 0 1 0.002729905
";
    pub(crate) const VELO: &str = "calib_time: 15-Mar-2012 11:37:16
R: 7.533745e-03 -9.999714e-01 -6.166020e-04 1.480249e-02 7.280733e-04 -9.998902e-01 9.998621e-01 7.523790e-03 1.480755e-02
T: -4.069766e-03 -7.631618e-02 -2.717806e-01
delta_f: 0.000000e+00 0.000000e+00
";

    #[test]
    fn a_recording_day_is_read() {
        let cam = CamToCam::parse(CAM).unwrap();
        assert_eq!((cam.width, cam.height), (1242, 375));
        assert_eq!(cam.focal_px(), 721.5377);
        // PROTOCOL 1.1: 0.532725 m
        assert!((cam.baseline_m() - 0.532_725_428).abs() < 1e-9);
        assert_eq!(cam.p_rect_02[1], [0.0, 721.5377, 172.854, 0.2163791]);
        assert_eq!(cam.r_rect_00[2], [0.00740, 0.00435, 0.99996]);

        let velo = VeloToCam::parse(VELO).unwrap();
        assert_eq!(velo.rotation[0][1], -9.999714e-01);
        assert_eq!(
            velo.translation,
            [-4.069766e-03, -7.631618e-02, -2.717806e-01]
        );
    }

    #[test]
    fn a_damaged_line_nobody_needs_is_passed_over() {
        assert!(CAM.contains("P_rect_00: 1,1+02"));
        assert!(CamToCam::parse(CAM).is_ok());
    }

    #[test]
    fn a_damaged_needed_line_is_named() {
        let text = CAM.replace("P_rect_02: 721.5377", "P_rect_02: 7,2+02");
        let error = CamToCam::parse(&text).unwrap_err();
        assert!(
            matches!(
                &error,
                CalibrationError::Damaged {
                    line: 6,
                    key: "P_rect_02",
                    numbers: 12,
                    ..
                }
            ),
            "{error:?}"
        );
        assert!(
            error.to_string().starts_with(
                "line 6: `P_rect_02` should have 12 finite numbers, but reads `7,2+02"
            )
        );

        let short = VELO.replace(" -2.717806e-01", "");
        assert!(matches!(
            VeloToCam::parse(&short),
            Err(CalibrationError::Damaged {
                line: 3,
                key: "T",
                ..
            })
        ));
        let nan = VELO.replace("-2.717806e-01", "nan");
        assert!(VeloToCam::parse(&nan).is_err());
    }

    #[test]
    fn the_wrong_file_is_recognised() {
        let error = CamToCam::parse(VELO).unwrap_err().to_string();
        assert_eq!(
            error,
            "line `S_rect_02: ...` (2 numbers) is missing, so this is not a complete calib_cam_to_cam file"
        );
        assert!(matches!(
            VeloToCam::parse(CAM),
            Err(CalibrationError::Missing { key: "R", .. })
        ));
    }

    #[test]
    fn cameras_that_cannot_be_are_refused() {
        for (from, to) in [
            ("S_rect_02: 1.242000e+03", "S_rect_02: 1242.5"),
            ("S_rect_02: 1.242000e+03", "S_rect_02: 0"),
            ("P_rect_02: 721.5377", "P_rect_02: 0"),
            ("-339.5242", "339.5242"),
        ] {
            let error = CamToCam::parse(&CAM.replace(from, to)).unwrap_err();
            assert!(
                matches!(error, CalibrationError::Impossible(_)),
                "{to}: {error:?}"
            );
        }
    }

    proptest! {
        #[test]
        fn any_text_is_read_or_refused_without_a_panic(text in "(?s).{0,400}") {
            let _ = CamToCam::parse(&text);
            let _ = VeloToCam::parse(&text);
        }

        #[test]
        fn one_changed_byte_never_panics(at in 0usize..500, byte in 0u8..128) {
            let mut bytes = CAM.as_bytes().to_vec();
            let at = at % bytes.len();
            bytes[at] = byte;
            let _ = CamToCam::parse(std::str::from_utf8(&bytes).unwrap());
        }
    }
}
