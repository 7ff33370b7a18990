//! Which file of a prepared set is where; no other code builds these paths.
//!
//! ```text
//! manifest.yaml                     what it is; written last, so a set without it is unfinished
//! settings.yaml                     what its files depend on; written first
//! train.csv  val.csv  test.csv      one line per sample
//! failures.csv                      only if something could not be used
//! images/DRIVE/left|right/FRAME.*   network-size pairs of KITTI, whose ids are DRIVE/FRAME
//! images/left|right/ID.*            those of every other collection
//! full/...                          originals of test images, in the same way
//! depth/KIND/ID.exr                 ground truth in metres
//! labels/KIND/ID.png                label maps
//! parts/0003-of-0008/               tables of a part of the set, until all are merged
//! ```
//!
//! Paths are relative to the set, with `/` between their parts.

use strat_splits::Role;

use super::{Content, FileRef, Sample};

/// Says what a set is. Written last: a set without it is unfinished.
pub const MANIFEST: &str = "manifest.yaml";

/// Marks a folder as the output of a preparation, finished or not.
pub const SETTINGS: &str = "settings.yaml";

/// Lists the inputs that could not be used.
pub const FAILURES: &str = "failures.csv";

/// Lists, in a part of a set, the frames of the whole: role and id, in order.
pub const FRAMES: &str = "frames.csv";

/// Folders of the files that samples refer to.
pub const FOLDERS: [&str; 4] = ["images", "full", "depth", "labels"];

/// Name of the table of a role.
pub fn table_name(role: Role) -> String {
    format!("{role}.csv")
}

/// One of the views of a stereo pair.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    /// The left, or only, view.
    Left,
    /// The right view.
    Right,
}

impl Side {
    /// `left` or `right`.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Left => "left",
            Self::Right => "right",
        }
    }
}

/// A kind of ground truth.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DepthKind {
    /// A scan, along the scanner's x axis.
    Velodyne,
    /// Along the optical axis: a scan, or the ground truth of own pairs.
    Camera,
    /// Stereo 2015, pixels visible in both images.
    Noc,
    /// Stereo 2015, all measured pixels.
    Occ,
    /// Annotated ("improved") depth of KITTI depth.
    Annotated,
    /// The laser grid of Make3D, smaller than the image.
    Laser,
}

impl DepthKind {
    /// All kinds.
    pub const ALL: [Self; 6] = [
        Self::Velodyne,
        Self::Camera,
        Self::Noc,
        Self::Occ,
        Self::Annotated,
        Self::Laser,
    ];

    /// The name in paths and on the command line.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Velodyne => "velodyne",
            Self::Camera => "camera",
            Self::Noc => "noc",
            Self::Occ => "occ",
            Self::Annotated => "annotated",
            Self::Laser => "laser",
        }
    }

    /// The file of this kind that a sample has.
    pub fn of(self, sample: &Sample) -> Option<&FileRef> {
        match self {
            Self::Velodyne => &sample.depth_velodyne,
            Self::Camera => &sample.depth_camera,
            Self::Noc => &sample.depth_noc,
            Self::Occ => &sample.depth_occ,
            Self::Annotated => &sample.depth_annotated,
            Self::Laser => &sample.depth_laser,
        }
        .as_ref()
    }
}

/// A kind of label map.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LabelKind {
    /// Label ids, 8 bits.
    Semantic,
    /// Instance ids, 16 bits.
    Instance,
}

impl LabelKind {
    /// The name in paths.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Semantic => "semantic",
            Self::Instance => "instance",
        }
    }
}

/// An image at network size.
pub fn image(content: Content, side: Side, id: &str, extension: &str) -> String {
    picture("images", content, side, id, extension)
}

/// An image at its own size.
pub fn full_image(content: Content, side: Side, id: &str, extension: &str) -> String {
    picture("full", content, side, id, extension)
}

/// Ground truth in metres.
pub fn depth(kind: DepthKind, id: &str) -> String {
    format!("depth/{}/{id}.exr", kind.as_str())
}

/// A label map.
pub fn label(kind: LabelKind, id: &str) -> String {
    format!("labels/{}/{id}.png", kind.as_str())
}

fn picture(folder: &str, content: Content, side: Side, id: &str, extension: &str) -> String {
    let side = side.as_str();
    match (content.split(), id.split_once('/')) {
        // The frames of a drive lie together, as KITTI has them.
        (Some(_), Some((drive, frame))) => format!("{folder}/{drive}/{side}/{frame}.{extension}"),
        _ => format!("{folder}/{side}/{id}.{extension}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_lie_by_drive_or_by_side() {
        let id = "2011_09_26_drive_0001/0000000005";
        assert_eq!(
            image(Content::Eigen, Side::Left, id, "png"),
            "images/2011_09_26_drive_0001/left/0000000005.png"
        );
        assert_eq!(
            full_image(Content::Kitti, Side::Right, "kitti2015/000006", "png"),
            "full/kitti2015/right/000006.png"
        );
        assert_eq!(
            image(
                Content::Cityscapes,
                Side::Right,
                "ulm/ulm_000000_000019",
                "jpg"
            ),
            "images/right/ulm/ulm_000000_000019.jpg"
        );
        assert_eq!(
            image(Content::Pairs, Side::Left, "a", "png"),
            "images/left/a.png"
        );
    }

    #[test]
    fn truth_lies_by_kind() {
        assert_eq!(
            depth(DepthKind::Noc, "kitti2015/000006"),
            "depth/noc/kitti2015/000006.exr"
        );
        assert_eq!(
            label(LabelKind::Semantic, "kitti2015/000006"),
            "labels/semantic/kitti2015/000006.png"
        );
        let names = DepthKind::ALL.map(DepthKind::as_str);
        assert_eq!(
            names,
            ["velodyne", "camera", "noc", "occ", "annotated", "laser"]
        );
    }

    #[test]
    fn every_kind_has_its_column() {
        let file = |path: &str| FileRef {
            path: path.to_owned(),
            blake3: String::new(),
        };
        let mut sample = Sample::new("a", (1, 1), 0.0, 0.0, file("left"));
        assert!(DepthKind::ALL.iter().all(|kind| kind.of(&sample).is_none()));
        sample.depth_velodyne = Some(file("velodyne"));
        sample.depth_camera = Some(file("camera"));
        sample.depth_noc = Some(file("noc"));
        sample.depth_occ = Some(file("occ"));
        sample.depth_annotated = Some(file("annotated"));
        sample.depth_laser = Some(file("laser"));
        for kind in DepthKind::ALL {
            assert_eq!(kind.of(&sample).unwrap().path, kind.as_str());
        }
    }
}
