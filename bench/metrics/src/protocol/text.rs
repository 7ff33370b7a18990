//! A protocol as text: the canonical one behind its digest, and sentences for people.

use super::camera::Camera;
use super::choices::{
    Alignment, BenchmarkCrop, Crop, D1Rule, GroundTruthKind, InfiniteDepth, LogBase,
    PostProcessing, Resize,
};
use super::group::{Group, Grouping};
use super::rules::Protocol;

impl Protocol {
    /// In words, what differs between two protocols: pairs of the sentence of `self` and of
    /// `other`, empty where one of them has no such sentence. Names and versions are left out.
    pub fn difference(&self, other: &Self) -> Vec<(String, String)> {
        let sentences = |protocol: &Self| -> Vec<(String, String)> {
            protocol
                .describe()
                .lines()
                .map(|line| {
                    let head = line.split_once(':').map_or(line, |(head, _)| head);
                    (head.to_owned(), line.to_owned())
                })
                .collect()
        };
        let (mine, theirs) = (sentences(self), sentences(other));
        let find = |all: &[(String, String)], head: &str| {
            all.iter()
                .find(|(other, _)| other == head)
                .map(|(_, line)| line.clone())
                .unwrap_or_default()
        };
        let mut heads: Vec<&String> = mine.iter().map(|(head, _)| head).collect();
        for (head, _) in &theirs {
            if !heads.contains(&head) {
                heads.push(head);
            }
        }
        heads
            .into_iter()
            .map(|head| (find(&mine, head), find(&theirs, head)))
            .filter(|(a, b)| a != b)
            .collect()
    }

    /// BLAKE3 digest, 64 hexadecimal digits, of all fields.
    pub fn digest(&self) -> String {
        blake3::hash(self.canonical_text().as_bytes())
            .to_hex()
            .to_string()
    }

    /// One `key=value` line per choice. Written by hand so that no change of a serialisation
    /// library can change a digest; numbers in Rust's shortest exact form.
    pub fn canonical_text(&self) -> String {
        // Taken apart without `..`, so that a new field cannot be forgotten here.
        let Self {
            name,
            version,
            ground_truth,
            camera,
            crop,
            min_depth_m,
            max_depth_m,
            mask_ground_truth,
            strict_comparisons,
            disparity_floor_fraction,
            infinite_depth,
            alignment,
            post_processing,
            d1_rule,
            grouping,
            resize,
            log_base,
            benchmark_crop,
        } = self;
        let ground_truth = match ground_truth {
            GroundTruthKind::StereoNoc => "stereo-noc",
            GroundTruthKind::StereoOcc => "stereo-occ",
            GroundTruthKind::VelodyneX => "velodyne-x",
            GroundTruthKind::CameraZ => "camera-z",
            GroundTruthKind::Annotated => "annotated",
            GroundTruthKind::Laser => "laser",
        };
        let camera = match camera {
            Camera::Nominal { baseline_m } => format!("nominal,baseline_m={baseline_m:?}"),
            Camera::Calibrated => "calibrated".to_owned(),
            Camera::Agreed {
                focal_fraction,
                baseline_m,
            } => format!("agreed,focal_fraction={focal_fraction:?},baseline_m={baseline_m:?}"),
            Camera::Unknown => "unknown".to_owned(),
        };
        let crop = match (crop, crop.fractions()) {
            (Crop::Pixels { rows, columns }, _) => format!(
                "pixels,{},{},{},{}",
                rows[0], rows[1], columns[0], columns[1]
            ),
            (_, None) => "none".to_owned(),
            (_, Some([top, bottom, left, right])) => {
                format!("truncate,{top:?},{bottom:?},{left:?},{right:?}")
            }
        };
        let infinite_depth = match infinite_depth {
            InfiniteDepth::FarLimit => "far-limit",
            InfiniteDepth::NearLimit => "near-limit",
        };
        let post_processing = match post_processing {
            PostProcessing::None => "none",
            PostProcessing::Flip => "flip",
        };
        let d1_rule = match d1_rule {
            None => "none",
            Some(D1Rule::Inclusive) => "error>=3px,error>=0.05",
            Some(D1Rule::Strict) => "error>3px,error>0.05",
        };
        let grouping = match grouping {
            Grouping::None => "none".to_owned(),
            Grouping::Cityscapes => {
                label_groups(|group, first, last| format!("{group}:{first}-{last}")).join(",")
            }
            Grouping::Distance => {
                format!("true-depth:{}", Group::DISTANCES.map(Group::name).join(","))
            }
        };
        let resize = match resize {
            Resize::DisparityBilinear => "disparity,bilinear",
            Resize::DepthNearest => "depth,nearest",
        };
        // A choice that came later stands here only where it is not the old habit, so that
        // older digests stay.
        let log_base = match log_base {
            LogBase::Natural => "",
            LogBase::Ten => "log_base=10\n",
        };
        let median_scaling = *alignment == Alignment::Median;
        let alignment = match alignment {
            Alignment::None | Alignment::Median => String::new(),
            alignment => format!("alignment={alignment}\n"),
        };
        let benchmark_crop = match benchmark_crop {
            BenchmarkCrop::None => "",
            BenchmarkCrop::Image => "benchmark_crop=image\n",
            BenchmarkCrop::ImageAndTruth => "benchmark_crop=image-and-truth\n",
        };
        format!(
            "name={name}\nversion={version}\nground_truth={ground_truth}\ncamera={camera}\n\
             crop={crop}\nmin_depth_m={min_depth_m:?}\nmax_depth_m={max_depth_m:?}\n\
             mask_ground_truth={mask_ground_truth}\nstrict_comparisons={strict_comparisons}\n\
             disparity_floor_fraction={disparity_floor_fraction:?}\n\
             infinite_depth={infinite_depth}\nmedian_scaling={median_scaling}\n\
             post_processing={post_processing}\nd1={d1_rule}\ngrouping={grouping}\n\
             resize={resize}\naveraging=unweighted-mean-over-images\n\
             {log_base}{alignment}{benchmark_crop}"
        )
    }

    /// The rules in words, one sentence per line.
    pub fn describe(&self) -> String {
        let mut lines = Vec::new();
        lines.push(
            match self.ground_truth {
                GroundTruthKind::StereoNoc => {
                    "Ground truth: KITTI stereo 2015 disparity, pixels visible in both images \
                     (disp_noc_0)."
                }
                GroundTruthKind::StereoOcc => {
                    "Ground truth: KITTI stereo 2015 disparity, all measured pixels (disp_occ_0)."
                }
                GroundTruthKind::VelodyneX => {
                    "Ground truth: Velodyne points in the left image, distance along the \
                     scanner's forward axis (about 0.3 m more than camera depth, as in all \
                     published rows)."
                }
                GroundTruthKind::CameraZ => {
                    "Ground truth: Velodyne points in the left image, depth along the camera's \
                     axis."
                }
                GroundTruthKind::Annotated => {
                    "Ground truth: KITTI depth (accumulated scans checked against stereo), depth \
                     along the camera's axis; 652 of the 697 test images have it."
                }
                GroundTruthKind::Laser => {
                    "Ground truth: Make3D laser grid, 305x21 after a central 2:1 crop."
                }
            }
            .to_owned(),
        );
        lines.push(match self.camera {
            Camera::Nominal { baseline_m } => format!(
                "Camera: focal length nominal for the image width, baseline {baseline_m} m for \
                 every image."
            ),
            Camera::Calibrated => {
                "Camera: focal length and baseline of the image's own calibration.".to_owned()
            }
            Camera::Agreed {
                focal_fraction,
                baseline_m,
            } => format!(
                "Camera: focal length {focal_fraction} of the image width and baseline \
                 {baseline_m} m for every image."
            ),
            Camera::Unknown if self.alignment != Alignment::None => {
                "Camera: none; depth is 1 / disparity and gets its unit from the scale.".to_owned()
            }
            Camera::Unknown => {
                "Camera: none; for models that give metres, which need none.".to_owned()
            }
        });
        lines.push(
            match self.resize {
                Resize::DisparityBilinear => {
                    "Prediction: disparity of the left image resized bilinearly to the ground \
                     truth's size, then turned into depth."
                }
                Resize::DepthNearest => {
                    "Prediction: depth at network size, of which the ground truth's grid takes \
                     the nearest neighbours."
                }
            }
            .to_owned(),
        );
        match self.benchmark_crop {
            BenchmarkCrop::None => {}
            BenchmarkCrop::Image => lines.push(
                "Image: KITTI's benchmark crop, 352 rows and 1216 columns, bottom and middle; the \
                 prediction goes back to its place, and the rest of the image has none."
                    .to_owned(),
            ),
            BenchmarkCrop::ImageAndTruth => lines.push(
                "Image: KITTI's benchmark crop, 352 rows and 1216 columns, bottom and middle; the \
                 ground truth is cut like the image."
                    .to_owned(),
            ),
        }
        if self.post_processing == PostProcessing::Flip {
            lines.push(
                "Post-processing: blended with the prediction for the mirrored image.".to_owned(),
            );
        }
        lines.push(match (self.crop, self.crop.fractions()) {
            (Crop::Pixels { rows, columns }, _) => format!(
                "Crop: rows {} to {} and columns {} to {} in pixels, upper ends excluded.",
                rows[0], rows[1], columns[0], columns[1]
            ),
            (_, None) => "Crop: none.".to_owned(),
            (_, Some([top, bottom, left, right])) => format!(
                "Crop: {:?}, rows {top} to {bottom} of the height, columns {left} to {right} of \
                 the width{}, products truncated.",
                self.crop,
                match self.benchmark_crop {
                    BenchmarkCrop::ImageAndTruth => " of what is left",
                    BenchmarkCrop::None | BenchmarkCrop::Image => "",
                }
            ),
        });
        let limits = if self.strict_comparisons {
            "strictly between"
        } else {
            "from"
        };
        lines.push(if self.mask_ground_truth {
            format!(
                "Pixels: true depth {limits} {} m and {} m.",
                self.min_depth_m, self.max_depth_m
            )
        } else {
            "Pixels: all with ground truth, whatever their depth.".to_owned()
        });
        if self.alignment.is_of_inverse_depth() {
            lines.push(
                "Floor: aligned inverse depth below 0.001 per metre is raised to it and counted."
                    .to_owned(),
            );
        } else if self.disparity_floor_fraction > 0.0 {
            lines.push(format!(
                "Floor: disparities below {} of the width are raised to it and counted.",
                self.disparity_floor_fraction
            ));
        } else {
            lines.push(format!(
                "Floor: none; a disparity of zero ends at the {} limit.",
                match self.infinite_depth {
                    InfiniteDepth::FarLimit => "far",
                    InfiniteDepth::NearLimit => "near",
                }
            ));
        }
        let fitted = match self.alignment {
            Alignment::None => None,
            Alignment::Median => {
                Some("Scale: each prediction is multiplied by median(true) / median(predicted).")
            }
            Alignment::ScaleDepth => Some(
                "Alignment: each image's depth is multiplied by a scale, by least squares to the \
                 true depth, which the scale has seen.",
            ),
            Alignment::AffineDepth => Some(
                "Alignment: each image's depth is multiplied by a scale and moved by a shift, by \
                 least squares to the true depth, which both have seen.",
            ),
            Alignment::ScaleDisparity => Some(
                "Alignment: each image's inverse depth is multiplied by a scale, by least squares \
                 to 1 / true depth where it is above 0; the scale has seen the truth.",
            ),
            Alignment::AffineDisparity => Some(
                "Alignment: each image's inverse depth is multiplied by a scale and moved by a \
                 shift, by least squares to 1 / true depth where it is above 0; both have seen the \
                 truth.",
            ),
        };
        lines.extend(fitted.map(str::to_owned));
        lines.push(format!(
            "Clip: predictions to {} m .. {} m.",
            self.min_depth_m, self.max_depth_m
        ));
        if self.log_base == LogBase::Ten {
            lines.push("Logarithm: RMSE log is taken to base 10.".to_owned());
        }
        match self.d1_rule {
            None => {}
            Some(D1Rule::Inclusive) => lines.push(
                "D1-all: percentage of pixels with an error of at least 3 px and at least 5 %."
                    .to_owned(),
            ),
            Some(D1Rule::Strict) => lines.push(
                "D1-all: percentage of pixels with an error above 3 px and above 5 %.".to_owned(),
            ),
        }
        match self.grouping {
            Grouping::None => {}
            Grouping::Cityscapes => lines.push(format!(
                "Groups: by Cityscapes label id: {}.",
                label_groups(|group, first, last| format!("{group} {first} to {last}")).join(", ")
            )),
            Grouping::Distance => lines.push(format!(
                "Groups: by true depth: {} (upper ends included).",
                Group::DISTANCES.map(Group::name).join(", ")
            )),
        }
        lines.push("Average: unweighted mean over images.".to_owned());
        lines.join("\n")
    }
}

fn label_groups(text: impl Fn(Group, u8, u8) -> String) -> Vec<String> {
    Group::SEMANTIC
        .into_iter()
        .filter_map(|group| {
            let (first, last) = group.label_ids()?;
            Some(text(group, first, last))
        })
        .collect()
}
