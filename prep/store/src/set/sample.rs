//! A sample of a set and the files it refers to.

/// A file of the set and what must be in it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FileRef {
    /// Path relative to the set, with `/` between its parts.
    pub path: String,
    /// BLAKE3 of its content, hex.
    pub blake3: String,
}

/// A stereo pair and what belongs to it.
#[derive(Debug, Clone, PartialEq)]
pub struct Sample {
    /// Drive and frame: `2011_09_26_drive_0001/0000000005` or `kitti2015/000006`.
    pub id: String,
    /// Width in pixels of the native image.
    pub width: u32,
    /// Height in pixels of the native image.
    pub height: u32,
    /// Focal length in pixels of the native image, from calibration; 0 where it is not known.
    pub focal_px: f64,
    /// Distance in metres between the cameras, from calibration; 0 where it is not known.
    pub baseline_m: f64,
    /// Left (or only) image at network size.
    pub left: FileRef,
    /// Right image at network size; single images have none.
    pub right: Option<FileRef>,
    /// Untouched left image.
    pub left_full: Option<FileRef>,
    /// Untouched right image.
    pub right_full: Option<FileRef>,
    /// Stereo 2015 ground truth of pixels visible in both images, EXR.
    pub depth_noc: Option<FileRef>,
    /// Stereo 2015 ground truth of all measured pixels, EXR.
    pub depth_occ: Option<FileRef>,
    /// Velodyne ground truth along the scanner's x axis, EXR.
    pub depth_velodyne: Option<FileRef>,
    /// Velodyne ground truth along the optical axis, EXR; of own pairs, their ground truth.
    pub depth_camera: Option<FileRef>,
    /// Annotated ("improved") ground truth of KITTI depth, EXR.
    pub depth_annotated: Option<FileRef>,
    /// Laser grid of Make3D, EXR; smaller than the image.
    pub depth_laser: Option<FileRef>,
    /// Label ids, 8-bit PNG.
    pub semantic: Option<FileRef>,
    /// Instance ids, 16-bit PNG.
    pub instance: Option<FileRef>,
}

impl Sample {
    /// A sample with its left image and nothing else; the other files are set by field.
    pub fn new(
        id: impl Into<String>,
        (width, height): (u32, u32),
        focal_px: f64,
        baseline_m: f64,
        left: FileRef,
    ) -> Self {
        Self {
            id: id.into(),
            width,
            height,
            focal_px,
            baseline_m,
            left,
            right: None,
            left_full: None,
            right_full: None,
            depth_noc: None,
            depth_occ: None,
            depth_velodyne: None,
            depth_camera: None,
            depth_annotated: None,
            depth_laser: None,
            semantic: None,
            instance: None,
        }
    }

    /// Where it was taken: what stands before the slash of its id, e.g. a drive of KITTI raw.
    /// An id without a slash is a place of its own.
    pub fn drive(&self) -> &str {
        self.id.split_once('/').map_or(&self.id, |(drive, _)| drive)
    }

    /// Every file it refers to, with the name of its column.
    pub fn files(&self) -> impl Iterator<Item = (&'static str, &FileRef)> {
        let left = [("left", Some(&self.left))].into_iter();
        left.chain(OPTIONAL_FILES.map(|(name, column)| (name, (column.get)(self).as_ref())))
            .filter_map(|(name, file)| Some((name, file?)))
    }
}

/// An optional file column of a table.
pub(super) struct FileColumn {
    pub get: fn(&Sample) -> &Option<FileRef>,
    pub set: fn(&mut Sample) -> &mut Option<FileRef>,
}

macro_rules! file_columns {
    ($($name:ident),*) => {
        [$((stringify!($name), FileColumn { get: |s| &s.$name, set: |s| &mut s.$name })),*]
    };
}

/// Names of the optional file columns and access to them, in the order of the table.
pub(super) const OPTIONAL_FILES: [(&str, FileColumn); 11] = file_columns![
    right,
    left_full,
    right_full,
    depth_noc,
    depth_occ,
    depth_velodyne,
    depth_camera,
    depth_annotated,
    depth_laser,
    semantic,
    instance
];

/// Longest id, and longest part of one between slashes, in bytes: what is longer is no file name on
/// common systems.
const LONGEST: (usize, usize) = (1000, 240);

/// Checks that an id can be part of file names of a set on every system.
///
/// # Errors
/// It cannot; a sentence that says why.
pub fn check_id(id: &str) -> Result<(), String> {
    if id.len() > LONGEST.0 || id.split('/').any(|part| part.len() > LONGEST.1) {
        let start: String = id.chars().take(40).collect();
        return Err(format!(
            "`{}...` is not a usable id: it becomes a file name in the set and is too long for one, with {} \
             bytes",
            start.escape_debug(),
            id.len()
        ));
    }
    if is_plain(id) {
        return Ok(());
    }
    Err(format!(
        "`{}` is not a usable id: it becomes a file name in the set, so it should be a plain name or a path \
         without `..`, without a slash at its ends and without \\ : * ? \" < > |",
        id.escape_debug()
    ))
}

/// Whether a path with `/` between its parts stays inside the folder it is put behind and can be a
/// file name everywhere.
pub(super) fn is_plain(path: &str) -> bool {
    let mut parts = path.split('/');
    parts.all(|part| !["", ".", ".."].contains(&part))
        && !path.contains(|c: char| c.is_control() || "\\:*?\"<>|".contains(c))
}

#[cfg(test)]
mod id_tests {
    use super::*;

    #[test]
    fn ids_stay_inside_the_set() {
        for good in ["a", "straße 7/bild 0001", "a/b/c.d", "...", "0"] {
            assert_eq!(check_id(good), Ok(()), "{good}");
        }
        for bad in [
            "", "/a", "../a", "a/../b", "a/", "a//b", "a/./b", ".", "a\\b", "C:a", "a\nb", "a\0b",
        ] {
            assert!(check_id(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn long_ids_are_named_by_their_beginning() {
        assert_eq!(check_id(&"a/".repeat(119)[..237]), Ok(()));
        assert!(
            check_id(&"x".repeat(241)).is_err() && check_id(&"a/".repeat(600)[..1199]).is_err()
        );
        let error = check_id(&"x".repeat(5000)).unwrap_err();
        assert!(error.contains("5000 bytes") && error.len() < 300, "{error}");
    }
}
