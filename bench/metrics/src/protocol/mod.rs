//! Named, versioned evaluation protocols.
//!
//! A protocol holds every choice that can change a figure. The values are those of the
//! reference evaluation of Godard et al. (CVPR 2017), see PROTOCOL 3.1 to 3.9; where the
//! reference has a habit that one would not choose today (truncated crop fractions, ground
//! truth in a lidar axis, a nominal baseline), the habit is a field here and not a constant
//! in the arithmetic.
//!
//! The digest of a protocol stands on each row computed under it. Changing what a protocol
//! means therefore changes its digest, and rows of the two meanings no longer mix.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// Which measured depth a prediction is compared with.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum GroundTruthKind {
    /// KITTI stereo 2015, `disp_noc_0`: pixels whose match lies inside the right image.
    StereoNoc,
    /// KITTI stereo 2015, `disp_occ_0`: every measured pixel.
    StereoOcc,
    /// Velodyne scan projected into the left image; the value is the scanner's own forward
    /// axis, about 0.27 m to 0.33 m more than the depth seen by the camera.
    VelodyneX,
    /// Velodyne scan projected into the left image; the value is the depth along the axis of
    /// the rectified camera.
    CameraZ,
    /// KITTI depth ("improved" ground truth): scans of eleven frames put together and checked
    /// against stereo; depth along the camera's axis. 652 of the 697 Eigen test images have it.
    Annotated,
    /// Make3D's laser grid, 305 columns x 21 rows after the central crop of PROTOCOL 1.4;
    /// distance in metres.
    Laser,
}

impl GroundTruthKind {
    /// True for ground truth that is stored as disparity.
    pub fn is_stereo(self) -> bool {
        matches!(self, Self::StereoNoc | Self::StereoOcc)
    }
}

/// Where focal length and baseline come from when disparity becomes depth.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Camera {
    /// One agreed baseline for every image; the focal length is the one nominal for the image
    /// width and is given by the caller.
    Nominal {
        /// Distance of the two cameras in metres.
        baseline_m: f64,
    },
    /// Focal length and baseline of the image's own calibration, both given by the caller.
    Calibrated,
    /// One agreed camera for every image, whatever its calibration: for disparity d as a
    /// fraction of width, depth = focal_fraction * baseline_m / d.
    Agreed {
        /// Focal length as a fraction of image width.
        focal_fraction: f64,
        /// Distance of the two cameras in metres.
        baseline_m: f64,
    },
    /// No camera: depth is 1 / disparity (as a fraction of width) in no unit, so only
    /// protocols with median scaling can use it.
    Unknown,
}

/// What is resized to the size of the ground truth, and how. The caller does it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Resize {
    /// Disparity, bilinear (PROTOCOL 3.3).
    #[default]
    DisparityBilinear,
    /// Depth, nearest neighbour (PROTOCOL 1.4); taking the nearest disparity is the same.
    DepthNearest,
}

/// Base of the logarithm in the metric `rmse_log`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LogBase {
    /// Natural logarithm, as everywhere on KITTI.
    #[default]
    Natural,
    /// Base 10, as on Make3D.
    Ten,
}

/// Part of the image that is scored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Crop {
    /// The whole image.
    None,
    /// Crop of Garg et al. (ECCV 2016).
    Garg,
    /// Crop of Eigen et al. (NIPS 2014).
    Eigen,
}

impl Crop {
    /// First row, end row, first column, end column as fractions of height and width.
    pub fn fractions(self) -> Option<[f64; 4]> {
        match self {
            Self::None => None,
            Self::Garg => Some([0.408_108_11, 0.991_891_89, 0.035_947_71, 0.964_052_29]),
            Self::Eigen => Some([0.332_432_4, 0.913_513_51, 0.035_947_7, 0.964_052_29]),
        }
    }

    /// What follows a protocol's name when only its crop is another one.
    pub fn ending(self) -> &'static str {
        match self {
            Self::None => "-nocrop",
            Self::Garg => "-garg",
            Self::Eigen => "-eigencrop",
        }
    }
}

/// What becomes of the infinite depth of a pixel whose disparity is exactly zero. It can be
/// met only where the disparity floor is switched off.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum InfiniteDepth {
    /// It is clipped to the far limit (reference, KITTI split).
    FarLimit,
    /// It is set to zero first and so ends at the near limit (reference, Eigen split).
    NearLimit,
}

/// When a disparity counts as wrong in D1-all: error of 3 px and 5 % of the true disparity.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum D1Rule {
    /// Errors equal to a limit count as wrong (reference evaluation of Godard et al.).
    Inclusive,
    /// Only errors above both limits count as wrong (KITTI 2015 development kit).
    Strict,
}

/// What is done with the network's disparity before it is resized.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PostProcessing {
    /// Nothing.
    None,
    /// Blend with the prediction for the mirrored image, see [`flip_blend`](crate::flip_blend).
    Flip,
}

/// Whether an image is scored as a whole, by what its pixels show, or by how far away they are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Grouping {
    /// One score per image.
    None,
    /// One score per image and semantic [`Group`] that the image contains.
    Cityscapes,
    /// One score per image and distance: by the true depth of a pixel.
    Distance,
}

impl Grouping {
    /// Its groups, in the order of tables and curves.
    #[must_use]
    pub fn groups(self) -> &'static [Group] {
        match self {
            Self::None => &[],
            Self::Cityscapes => &Group::SEMANTIC,
            Self::Distance => &Group::DISTANCES,
        }
    }
}

/// A group of pixels: what they show (the rows of thesis table 3.2, groups of Cityscapes label
/// ids), or how far away they are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Group {
    /// Road, sidewalk, parking, rail track.
    Flat,
    /// Person, rider.
    Human,
    /// Cars to bicycles.
    Vehicle,
    /// Building, wall, fence, guard rail, bridge, tunnel.
    Construction,
    /// Poles, traffic lights and signs.
    Object,
    /// True depth up to 5 m.
    To5m,
    /// True depth above 5 m and up to 10 m.
    To10m,
    /// Above 10 m and up to 15 m.
    To15m,
    /// Above 15 m and up to 20 m.
    To20m,
    /// Above 20 m and up to 30 m.
    To30m,
    /// Above 30 m and up to 40 m.
    To40m,
    /// Above 40 m and up to 50 m.
    To50m,
    /// Above 50 m and up to 60 m.
    To60m,
    /// Above 60 m and up to 80 m.
    To80m,
    /// True depth above 80 m.
    Over80m,
}

impl Group {
    /// Groups of labels in the order of the thesis' table.
    pub const SEMANTIC: [Self; 5] = [
        Self::Flat,
        Self::Human,
        Self::Vehicle,
        Self::Construction,
        Self::Object,
    ];

    /// Groups of distance, near to far.
    pub const DISTANCES: [Self; 10] = [
        Self::To5m,
        Self::To10m,
        Self::To15m,
        Self::To20m,
        Self::To30m,
        Self::To40m,
        Self::To50m,
        Self::To60m,
        Self::To80m,
        Self::Over80m,
    ];

    /// All groups.
    pub fn all() -> impl Iterator<Item = Self> {
        Self::SEMANTIC.into_iter().chain(Self::DISTANCES)
    }

    /// First and last Cityscapes label id of a semantic group; the ids of each are contiguous.
    pub fn label_ids(self) -> Option<(u8, u8)> {
        match self {
            Self::Flat => Some((7, 10)),
            Self::Human => Some((24, 25)),
            Self::Vehicle => Some((26, 33)),
            Self::Construction => Some((11, 16)),
            Self::Object => Some((17, 20)),
            _ => None,
        }
    }

    /// True depth in metres of a group of distance: above the first number, up to the second,
    /// which is infinite for the last group.
    pub fn distance_m(self) -> Option<(f64, f64)> {
        let place = Self::DISTANCES.iter().position(|group| *group == self)?;
        let ends = [
            0.0,
            5.0,
            10.0,
            15.0,
            20.0,
            30.0,
            40.0,
            50.0,
            60.0,
            80.0,
            f64::INFINITY,
        ];
        Some((ends[place], ends[place + 1]))
    }

    /// Group of a Cityscapes label id; void, nature and sky belong to none.
    pub fn of_label(id: u8) -> Option<Self> {
        Self::SEMANTIC.into_iter().find(|group| {
            group
                .label_ids()
                .is_some_and(|(first, last)| (first..=last).contains(&id))
        })
    }

    /// Group of a true depth in metres; none of what is no distance.
    pub fn of_depth(depth_m: f64) -> Option<Self> {
        Self::DISTANCES.into_iter().find(|group| {
            group
                .distance_m()
                .is_some_and(|(above, end)| depth_m > above && depth_m <= end)
        })
    }

    /// Lower-case name as it stands in `rows.csv`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Flat => "flat",
            Self::Human => "human",
            Self::Vehicle => "vehicle",
            Self::Construction => "construction",
            Self::Object => "object",
            Self::To5m => "0-5m",
            Self::To10m => "5-10m",
            Self::To15m => "10-15m",
            Self::To20m => "15-20m",
            Self::To30m => "20-30m",
            Self::To40m => "30-40m",
            Self::To50m => "40-50m",
            Self::To60m => "50-60m",
            Self::To80m => "60-80m",
            Self::Over80m => "over-80m",
        }
    }
}

impl Serialize for Group {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.name())
    }
}

impl fmt::Display for Group {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

/// Text that is no [`Group`].
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "the groups are flat, human, vehicle, construction and object, and distances from 0-5m to \
     over-80m, not {0:?}"
)]
pub struct UnknownGroup(pub String);

impl FromStr for Group {
    type Err = UnknownGroup;

    fn from_str(text: &str) -> Result<Self, UnknownGroup> {
        Self::all()
            .find(|group| group.name() == text)
            .ok_or_else(|| UnknownGroup(text.to_owned()))
    }
}

/// A complete set of evaluation rules.
///
/// Every protocol averages images without weights.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Protocol {
    /// Name used on command lines and in files.
    pub name: String,
    /// Counts the changes of meaning under this name.
    pub version: u32,
    /// What predictions are compared with.
    pub ground_truth: GroundTruthKind,
    /// Focal length and baseline.
    pub camera: Camera,
    /// Part of the image that is scored; fractions are multiplied in double precision and
    /// truncated.
    pub crop: Crop,
    /// Near limit in metres, to which predictions are clipped.
    pub min_depth_m: f64,
    /// Far limit in metres, to which predictions are clipped.
    pub max_depth_m: f64,
    /// Leave out pixels whose true depth is outside the two limits. Otherwise each measured
    /// pixel counts, with its true depth unclipped.
    pub mask_ground_truth: bool,
    /// A value on a limit is outside: depth limits of the mask and accuracy thresholds.
    pub strict_comparisons: bool,
    /// Smaller disparities, as a fraction of image width, are raised to this value and
    /// counted; 0 switches the floor off.
    pub disparity_floor_fraction: f64,
    /// What becomes of infinite depth where there is no floor.
    pub infinite_depth: InfiniteDepth,
    /// Multiply each prediction by median(true) / median(predicted) before clipping. Only for
    /// methods that cannot know the scale.
    pub median_scaling: bool,
    /// What is done with the disparity before it is resized.
    pub post_processing: PostProcessing,
    /// How D1-all counts, for protocols that report it.
    pub d1_rule: Option<D1Rule>,
    /// Whole images, or groups of label ids.
    pub grouping: Grouping,
    /// What is resized to the size of the ground truth, and how.
    #[serde(default)]
    pub resize: Resize,
    /// Base of the logarithm in `rmse_log`.
    #[serde(default)]
    pub log_base: LogBase,
}

impl Protocol {
    fn kitti2015(name: &str, ground_truth: GroundTruthKind) -> Self {
        Self {
            name: name.to_owned(),
            version: 1,
            ground_truth,
            camera: Camera::Nominal { baseline_m: 0.54 },
            crop: Crop::None,
            min_depth_m: 1e-3,
            max_depth_m: 80.0,
            mask_ground_truth: false,
            strict_comparisons: true,
            disparity_floor_fraction: 1e-4,
            infinite_depth: InfiniteDepth::FarLimit,
            median_scaling: false,
            post_processing: PostProcessing::None,
            d1_rule: Some(D1Rule::Inclusive),
            grouping: Grouping::None,
            resize: Resize::DisparityBilinear,
            log_base: LogBase::Natural,
        }
    }

    fn eigen(name: &str, ground_truth: GroundTruthKind, min_m: f64, max_m: f64) -> Self {
        Self {
            name: name.to_owned(),
            version: 1,
            ground_truth,
            camera: Camera::Calibrated,
            crop: Crop::Garg,
            min_depth_m: min_m,
            max_depth_m: max_m,
            mask_ground_truth: true,
            strict_comparisons: true,
            disparity_floor_fraction: 1e-4,
            infinite_depth: InfiniteDepth::NearLimit,
            median_scaling: false,
            post_processing: PostProcessing::None,
            d1_rule: None,
            grouping: Grouping::None,
            resize: Resize::DisparityBilinear,
            log_base: LogBase::Natural,
        }
    }

    /// The same rules with median scaling, named `<name>-median`.
    #[must_use]
    pub fn with_median_scaling(mut self) -> Self {
        if !self.median_scaling {
            self.median_scaling = true;
            self.name.push_str("-median");
        }
        self
    }

    /// The same rules with flip post-processing, named `<name>-pp`.
    #[must_use]
    pub fn with_flip(mut self) -> Self {
        if self.post_processing != PostProcessing::Flip {
            self.post_processing = PostProcessing::Flip;
            self.name.push_str("-pp");
        }
        self
    }

    /// The same rules, scored by how far away pixels are ([`Grouping::Distance`]), named
    /// `<name>-distance`. A protocol that has groups already keeps them.
    #[must_use]
    pub fn by_distance(mut self) -> Self {
        if self.grouping == Grouping::None {
            self.grouping = Grouping::Distance;
            self.name.push_str("-distance");
        }
        self
    }

    /// The same rules with another crop, named `<name>-nocrop`, `<name>-garg` or
    /// `<name>-eigencrop`.
    #[must_use]
    pub fn with_crop(mut self, crop: Crop) -> Self {
        if self.crop != crop {
            self.crop = crop;
            self.name.push_str(crop.ending());
        }
        self
    }

    /// A sentence if the choices contradict each other or are no usable numbers.
    ///
    /// # Errors
    /// That sentence, without the protocol's name.
    pub fn check(&self) -> Result<(), String> {
        let plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
        if self.name.is_empty() || !self.name.chars().all(plain) {
            return Err("its name must be made of letters, digits, `-`, `_` and `.`".to_owned());
        }
        let (min, max) = (self.min_depth_m as f32, self.max_depth_m as f32);
        if !(min > 0.0 && min < max && max.is_finite()) {
            return Err(format!(
                "its depth limits are {} and {}, but must be 0 < min < max",
                self.min_depth_m, self.max_depth_m
            ));
        }
        let floor = self.disparity_floor_fraction;
        if !(0.0..1.0).contains(&floor) {
            return Err(format!(
                "its disparity floor is {floor}, but must be a fraction of the width from 0 up"
            ));
        }
        let positive = |what: &str, value: f64| {
            if value > 0.0 && (value as f32).is_normal() {
                Ok(())
            } else {
                Err(format!("its {what} is {value}, but must be positive"))
            }
        };
        match self.camera {
            Camera::Nominal { baseline_m } => positive("baseline", baseline_m)?,
            Camera::Agreed {
                focal_fraction,
                baseline_m,
            } => {
                positive("baseline", baseline_m)?;
                positive("focal length", focal_fraction)?;
            }
            Camera::Unknown if !self.median_scaling => {
                return Err(
                    "without a camera depth has no unit, so it needs `median_scaling: true`"
                        .to_owned(),
                );
            }
            Camera::Calibrated | Camera::Unknown => {}
        }
        if matches!(self.camera, Camera::Nominal { .. }) && !self.ground_truth.is_stereo() {
            return Err(
                "a nominal camera is known for stereo 2015 ground truth only; use `calibrated`"
                    .to_owned(),
            );
        }
        if self.ground_truth.is_stereo()
            && matches!(self.camera, Camera::Agreed { .. } | Camera::Unknown)
        {
            return Err(
                "stereo ground truth becomes depth with the camera of the image, so the camera \
                 must be nominal or calibrated"
                    .to_owned(),
            );
        }
        if self.d1_rule.is_some() && !self.ground_truth.is_stereo() {
            return Err("D1-all needs ground truth that is disparity".to_owned());
        }
        if self.grouping != Grouping::None && self.ground_truth == GroundTruthKind::Laser {
            return Err("there are no labels for the laser grid".to_owned());
        }
        Ok(())
    }

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
            median_scaling,
            post_processing,
            d1_rule,
            grouping,
            resize,
            log_base,
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
        let crop = match crop.fractions() {
            None => "none".to_owned(),
            Some([top, bottom, left, right]) => {
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
        format!(
            "name={name}\nversion={version}\nground_truth={ground_truth}\ncamera={camera}\n\
             crop={crop}\nmin_depth_m={min_depth_m:?}\nmax_depth_m={max_depth_m:?}\n\
             mask_ground_truth={mask_ground_truth}\nstrict_comparisons={strict_comparisons}\n\
             disparity_floor_fraction={disparity_floor_fraction:?}\n\
             infinite_depth={infinite_depth}\nmedian_scaling={median_scaling}\n\
             post_processing={post_processing}\nd1={d1_rule}\ngrouping={grouping}\n\
             resize={resize}\naveraging=unweighted-mean-over-images\n{log_base}"
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
            Camera::Unknown => {
                "Camera: none; depth is 1 / disparity and gets its unit from the scale.".to_owned()
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
        if self.post_processing == PostProcessing::Flip {
            lines.push(
                "Post-processing: blended with the prediction for the mirrored image.".to_owned(),
            );
        }
        lines.push(match self.crop.fractions() {
            None => "Crop: none.".to_owned(),
            Some([top, bottom, left, right]) => format!(
                "Crop: {:?}, rows {top} to {bottom} of the height, columns {left} to {right} of \
                 the width, products truncated.",
                self.crop
            ),
        });
        let ends = if self.strict_comparisons {
            "strictly between"
        } else {
            "from"
        };
        lines.push(if self.mask_ground_truth {
            format!(
                "Pixels: true depth {ends} {} m and {} m.",
                self.min_depth_m, self.max_depth_m
            )
        } else {
            "Pixels: all with ground truth, whatever their depth.".to_owned()
        });
        if self.disparity_floor_fraction > 0.0 {
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
        if self.median_scaling {
            lines.push(
                "Scale: each prediction is multiplied by median(true) / median(predicted)."
                    .to_owned(),
            );
        }
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

/// All named protocols, those of the thesis' tables first.
pub fn protocols() -> Vec<Protocol> {
    use GroundTruthKind::{Annotated, CameraZ, Laser, StereoNoc, StereoOcc, VelodyneX};
    vec![
        Protocol::kitti2015("kitti2015", StereoNoc),
        Protocol {
            d1_rule: None,
            grouping: Grouping::Cityscapes,
            ..Protocol::kitti2015("semantic", StereoNoc)
        },
        Protocol::eigen("eigen-80", VelodyneX, 1e-3, 80.0),
        Protocol::eigen("eigen-50", VelodyneX, 1e-3, 50.0),
        Protocol::kitti2015("kitti2015-occ", StereoOcc),
        Protocol {
            camera: Camera::Calibrated,
            ..Protocol::kitti2015("kitti2015-calibrated", StereoNoc)
        },
        Protocol::eigen("eigen-50-min1", VelodyneX, 1.0, 50.0),
        Protocol::eigen("eigen-cameraz-80", CameraZ, 1e-3, 80.0),
        Protocol::eigen("eigen-cameraz-50", CameraZ, 1e-3, 50.0),
        // PROTOCOL 3.8, `eigen_benchmark`: every measured pixel counts, whatever its depth.
        Protocol {
            crop: Crop::None,
            mask_ground_truth: false,
            ..Protocol::eigen("eigen-improved", Annotated, 1e-3, 80.0)
        },
        // PROTOCOL 3.8: monodepth2 masks, scales and clips as here, and its order gives the
        // figures of eigen-80. What differs is its camera: depth in metres is 5.4 times the
        // network's depth, which was trained with a focal length of 0.58 widths and a baseline
        // of 0.1 for 0.54 m, for every image; and nothing keeps disparity from being small.
        Protocol {
            camera: Camera::Agreed {
                focal_fraction: 0.58,
                baseline_m: 0.54,
            },
            disparity_floor_fraction: 0.0,
            infinite_depth: InfiniteDepth::FarLimit,
            ..Protocol::eigen("eigen-monodepth2", VelodyneX, 1e-3, 80.0)
        },
        // PROTOCOL 1.4, criterion C1.
        Protocol {
            camera: Camera::Unknown,
            crop: Crop::None,
            median_scaling: true,
            resize: Resize::DepthNearest,
            log_base: LogBase::Ten,
            ..Protocol::eigen("make3d-c1", Laser, 1e-3, 70.0)
        },
    ]
}

/// The protocol of that name. `-median`, `-pp`, `-distance` and a crop (`-nocrop`, `-garg`,
/// `-eigencrop`) may follow a name, in the order in which [`Protocol::with_median_scaling`],
/// [`Protocol::with_flip`], [`Protocol::by_distance`] and [`Protocol::with_crop`] would be called.
pub fn protocol(name: &str) -> Option<Protocol> {
    if let Some(found) = protocols().into_iter().find(|known| known.name == name) {
        return Some(found);
    }
    if let Some(base) = name.strip_suffix("-median") {
        return protocol(base)
            .filter(|p| !p.median_scaling)
            .map(Protocol::with_median_scaling);
    }
    if let Some(base) = name.strip_suffix("-distance") {
        return protocol(base)
            .filter(|p| p.grouping == Grouping::None)
            .map(Protocol::by_distance);
    }
    for crop in [Crop::None, Crop::Garg, Crop::Eigen] {
        if let Some(base) = name.strip_suffix(crop.ending()) {
            return protocol(base)
                .filter(|p| p.crop != crop)
                .map(|p| p.with_crop(crop));
        }
    }
    let base = name.strip_suffix("-pp")?;
    protocol(base)
        .filter(|p| p.post_processing == PostProcessing::None)
        .map(Protocol::with_flip)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn names_are_found_and_digests_differ() {
        let all = protocols();
        for known in &all {
            assert_eq!(protocol(&known.name).as_ref(), Some(known));
        }
        let digests: BTreeSet<String> = all.iter().map(Protocol::digest).collect();
        assert_eq!((all.len(), digests.len()), (12, 12));
        assert!(all.iter().all(|known| known.check().is_ok()));
        assert_eq!(protocol("eigen"), None);
    }

    /// A failing line here means that the meaning of rows measured so far has changed: raise
    /// the version of the protocol. Recipe: BLAKE3 of the canonical text, first run.
    #[test]
    fn digests_of_the_tables_protocols_stay() {
        let digest = |name| protocol(name).unwrap().digest();
        assert_eq!(
            ["kitti2015", "semantic", "eigen-80", "eigen-50"].map(digest),
            [
                "a569e08a7e07ac2d32b57a77b85b605f0e5032c44a71f3e848373bc9b4eaa889",
                "300e54cd800567fa66dd8bce13bfe06e92924f454f49d823b38fd054e2366f88",
                "2bc91e5df36c305fb69912f774374ae1a5a54c2debb6d83c21bef3b25cbfa8db",
                "c64c43f21b30cf5fbc3105033b6770af18a5e803b1fc426dc7974275877ab049",
            ]
        );
    }

    #[test]
    fn the_canonical_text_names_every_choice() {
        assert_eq!(
            protocol("eigen-80").unwrap().canonical_text(),
            "name=eigen-80\nversion=1\nground_truth=velodyne-x\ncamera=calibrated\n\
             crop=truncate,0.40810811,0.99189189,0.03594771,0.96405229\nmin_depth_m=0.001\n\
             max_depth_m=80.0\nmask_ground_truth=true\nstrict_comparisons=true\n\
             disparity_floor_fraction=0.0001\ninfinite_depth=near-limit\nmedian_scaling=false\n\
             post_processing=none\nd1=none\ngrouping=none\nresize=disparity,bilinear\n\
             averaging=unweighted-mean-over-images\n"
        );
    }

    #[test]
    fn endings_change_the_rules() {
        let both = protocol("eigen-80-median-pp").unwrap();
        assert!(both.median_scaling && both.post_processing == PostProcessing::Flip);
        assert_eq!(both.name, "eigen-80-median-pp");
        assert_ne!(both.digest(), protocol("eigen-80-pp").unwrap().digest());
        assert_eq!(protocol("eigen-80-pp-pp"), None);
        assert_eq!(protocol("eigen-80-median-median"), None);
        assert_eq!(protocol("-median"), None);

        let bare = protocol("eigen-80-nocrop-pp").unwrap();
        assert_eq!(
            (bare.crop, bare.name.as_str()),
            (Crop::None, "eigen-80-nocrop-pp")
        );
        let eigen = protocol("eigen-50-eigencrop").unwrap();
        assert_eq!((eigen.crop, eigen.max_depth_m), (Crop::Eigen, 50.0));
        // Its own crop is no variant.
        assert_eq!(protocol("eigen-80-garg"), None);
        assert_eq!(protocol("kitti2015-nocrop"), None);
        let far = protocol("eigen-80-median-distance").unwrap();
        assert!(far.grouping == Grouping::Distance && far.median_scaling);
        assert_eq!(protocol("semantic-distance"), None);
        assert_eq!(protocol("eigen-80-distance-distance"), None);
        // The scale of Make3D is always the median's.
        assert_eq!(protocol("make3d-c1-median"), None);
    }

    #[test]
    fn differences_are_told_in_sentences() {
        let [a, b, m] = ["eigen-80", "eigen-50", "eigen-80-median"].map(|n| protocol(n).unwrap());
        assert!(a.difference(&a).is_empty());
        assert_eq!(
            a.difference(&b),
            [
                (
                    "Pixels: true depth strictly between 0.001 m and 80 m.".to_owned(),
                    "Pixels: true depth strictly between 0.001 m and 50 m.".to_owned()
                ),
                (
                    "Clip: predictions to 0.001 m .. 80 m.".to_owned(),
                    "Clip: predictions to 0.001 m .. 50 m.".to_owned()
                ),
            ]
        );
        let scale = a.difference(&m);
        assert!(scale.len() == 1 && scale[0].0.is_empty() && scale[0].1.starts_with("Scale:"));
        // No two protocols may be told apart by their digests only.
        for x in protocols() {
            for y in protocols().iter().filter(|y| y.name != x.name) {
                assert!(!x.difference(y).is_empty(), "{} and {}", x.name, y.name);
            }
        }
    }

    #[test]
    fn contradictions_are_found() {
        let eigen = || protocol("eigen-80").unwrap();
        for wrong in [
            Protocol {
                name: "a b".to_owned(),
                ..eigen()
            },
            Protocol {
                max_depth_m: f64::NAN,
                ..eigen()
            },
            Protocol {
                disparity_floor_fraction: -0.1,
                ..eigen()
            },
            Protocol {
                camera: Camera::Unknown,
                ..eigen()
            },
            Protocol {
                camera: Camera::Nominal { baseline_m: 0.54 },
                ..eigen()
            },
            Protocol {
                d1_rule: Some(D1Rule::Strict),
                ..eigen()
            },
            Protocol {
                camera: Camera::Agreed {
                    focal_fraction: 0.58,
                    baseline_m: 0.0,
                },
                ..eigen()
            },
        ] {
            assert!(wrong.check().is_err(), "{wrong:?}");
        }
    }

    #[test]
    fn yaml_round_trip_and_unknown_keys() {
        for known in protocols() {
            let text = serde_yaml::to_string(&known).unwrap();
            assert_eq!(serde_yaml::from_str::<Protocol>(&text).unwrap(), known);
            let more = format!("{text}crop_fraction: 1\n");
            assert!(serde_yaml::from_str::<Protocol>(&more).is_err());
        }
    }

    /// Every id of the Cityscapes table (PROTOCOL 1.3) and what has no group.
    #[test]
    fn label_ids_of_the_groups() {
        let ids = |group| {
            (0..=255)
                .filter(|&id| Group::of_label(id) == group)
                .collect::<Vec<u8>>()
        };
        assert_eq!(ids(Some(Group::Flat)), [7, 8, 9, 10]);
        assert_eq!(ids(Some(Group::Construction)), [11, 12, 13, 14, 15, 16]);
        assert_eq!(ids(Some(Group::Object)), [17, 18, 19, 20]);
        assert_eq!(ids(Some(Group::Human)), [24, 25]);
        assert_eq!(ids(Some(Group::Vehicle)), [26, 27, 28, 29, 30, 31, 32, 33]);
        assert_eq!(ids(None).len(), 256 - 24);
        for group in Group::all() {
            assert_eq!(group.to_string().parse(), Ok(group));
            assert_ne!(group.label_ids().is_some(), group.distance_m().is_some());
        }
        assert!("sky".parse::<Group>().is_err());
    }

    /// Each depth has one distance; ends belong to the nearer group.
    #[test]
    fn distances_of_the_groups() {
        let ends: Vec<(f64, f64)> = Group::DISTANCES
            .iter()
            .filter_map(|group| group.distance_m())
            .collect();
        assert!(ends.windows(2).all(|pair| pair[0].1 == pair[1].0));
        for (depth_m, group) in [
            (1e-9, Some(Group::To5m)),
            (5.0, Some(Group::To5m)),
            (5.001, Some(Group::To10m)),
            (80.0, Some(Group::To80m)),
            (80.1, Some(Group::Over80m)),
            (0.0, None),
            (f64::NAN, None),
        ] {
            assert_eq!(Group::of_depth(depth_m), group, "{depth_m}");
        }
        for group in Group::DISTANCES {
            let (above, end) = group.distance_m().unwrap();
            let name = group.name();
            assert!(
                name == format!("{above}-{end}m") || name == format!("over-{above}m"),
                "{name}"
            );
        }
    }

    #[test]
    fn words() {
        insta::assert_snapshot!(protocol("kitti2015").unwrap().describe(), @r#"
        Ground truth: KITTI stereo 2015 disparity, pixels visible in both images (disp_noc_0).
        Camera: focal length nominal for the image width, baseline 0.54 m for every image.
        Prediction: disparity of the left image resized bilinearly to the ground truth's size, then turned into depth.
        Crop: none.
        Pixels: all with ground truth, whatever their depth.
        Floor: disparities below 0.0001 of the width are raised to it and counted.
        Clip: predictions to 0.001 m .. 80 m.
        D1-all: percentage of pixels with an error of at least 3 px and at least 5 %.
        Average: unweighted mean over images.
        "#);
        insta::assert_snapshot!(protocol("eigen-50-median-pp").unwrap().describe(), @r#"
        Ground truth: Velodyne points in the left image, distance along the scanner's forward axis (about 0.3 m more than camera depth, as in all published rows).
        Camera: focal length and baseline of the image's own calibration.
        Prediction: disparity of the left image resized bilinearly to the ground truth's size, then turned into depth.
        Post-processing: blended with the prediction for the mirrored image.
        Crop: Garg, rows 0.40810811 to 0.99189189 of the height, columns 0.03594771 to 0.96405229 of the width, products truncated.
        Pixels: true depth strictly between 0.001 m and 50 m.
        Floor: disparities below 0.0001 of the width are raised to it and counted.
        Scale: each prediction is multiplied by median(true) / median(predicted).
        Clip: predictions to 0.001 m .. 50 m.
        Average: unweighted mean over images.
        "#);
        insta::assert_snapshot!(protocol("semantic").unwrap().describe(), @r#"
        Ground truth: KITTI stereo 2015 disparity, pixels visible in both images (disp_noc_0).
        Camera: focal length nominal for the image width, baseline 0.54 m for every image.
        Prediction: disparity of the left image resized bilinearly to the ground truth's size, then turned into depth.
        Crop: none.
        Pixels: all with ground truth, whatever their depth.
        Floor: disparities below 0.0001 of the width are raised to it and counted.
        Clip: predictions to 0.001 m .. 80 m.
        Groups: by Cityscapes label id: flat 7 to 10, human 24 to 25, vehicle 26 to 33, construction 11 to 16, object 17 to 20.
        Average: unweighted mean over images.
        "#);
    }
}
