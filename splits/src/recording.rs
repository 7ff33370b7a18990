//! What was recorded together. Images of one drive are alike: statistics count drives, not images.

use std::fmt;
use std::sync::LazyLock;

use crate::frame::DriveId;
use crate::table::kitti2015_origin;

/// What an image was recorded with.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Recording<'a> {
    /// A drive of KITTI raw.
    Drive(DriveId),
    /// A folder of a user's own that is called like a drive, `NAME_drive_NUMBER`.
    Folder(&'a str),
    /// Stereo 2015 scenes without a known drive that stand side by side in the index, first and
    /// last. The scenes are in order of their drives, so these are one drive or a few, and no other
    /// scene belongs to them (PROTOCOL 11).
    Scenes(usize, usize),
    /// An image that says nothing about its origin.
    Image(&'a str),
}

impl fmt::Display for Recording<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Drive(drive) => drive.fmt(f),
            Self::Folder(name) | Self::Image(name) => f.pad(name),
            Self::Scenes(first, last) if first == last => write!(f, "kitti2015/{first:06}"),
            Self::Scenes(first, last) => write!(f, "kitti2015/{first:06}..{last:06}"),
        }
    }
}

/// The recording of an image by its id: `2011_09_26_drive_0001/0000000005` or `kitti2015/000006`.
pub fn recording(id: &str) -> Recording<'_> {
    let Some((folder, name)) = id.split_once('/') else {
        return Recording::Image(id);
    };
    if folder == "kitti2015" {
        let known = name
            .parse()
            .ok()
            .and_then(|number: usize| SCENES.get(number));
        return known.copied().unwrap_or(Recording::Image(id));
    }
    match folder.parse() {
        Ok(drive) => Recording::Drive(drive),
        Err(_) if folder.contains("_drive_") => Recording::Folder(folder),
        Err(_) => Recording::Image(id),
    }
}

/// The recordings of the stereo 2015 scenes. No run of unknown origin crosses a change of the
/// recording day (the images then have another size), so none need be cut.
static SCENES: LazyLock<Vec<Recording<'static>>> = LazyLock::new(|| {
    let origin = kitti2015_origin();
    let mut scenes = Vec::with_capacity(origin.len());
    while scenes.len() < origin.len() {
        let first = scenes.len();
        match origin[first] {
            Some(frame) => scenes.push(Recording::Drive(frame.drive)),
            None => {
                let unknown = origin[first..].iter().take_while(|frame| frame.is_none());
                let end = first + unknown.count();
                scenes.resize(end, Recording::Scenes(first, end - 1));
            }
        }
    }
    scenes
});

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::split::kitti2015_id;

    #[test]
    fn recordings_are_read_from_ids() {
        let drive = Recording::Drive("2011_09_26_drive_0001".parse().unwrap());
        assert_eq!(recording("2011_09_26_drive_0001/0000000005"), drive);
        assert_eq!(
            recording("mine_drive_7/3"),
            Recording::Folder("mine_drive_7")
        );
        for id in [
            "picture",
            "folder/picture",
            "kitti2015/000200",
            "kitti2015/x",
        ] {
            assert_eq!(recording(id), Recording::Image(id));
        }
    }

    /// PROTOCOL 11: 29 known drives in ascending order and ten runs of unknown scenes, none of them
    /// across a change of the image size (scenes 155, 157 and 170 begin another one).
    #[test]
    fn stereo_2015_scenes_are_29_drives_and_ten_runs() {
        let mut sizes: BTreeMap<Recording<'_>, usize> = BTreeMap::new();
        let ids: Vec<String> = (0..200).map(kitti2015_id).collect();
        for id in &ids {
            *sizes.entry(recording(id)).or_default() += 1;
        }
        let runs: Vec<String> = sizes
            .keys()
            .filter(|one| matches!(one, Recording::Scenes(..)))
            .map(|one| one.to_string().replace("kitti2015/000", ""))
            .collect();
        assert_eq!(
            runs,
            [
                "000..000001",
                "004..000006",
                "082",
                "087",
                "099..000104",
                "133..000140",
                "151..000154",
                "156",
                "165..000167",
                "170..000198"
            ]
        );
        assert_eq!((sizes.len(), sizes.values().sum::<usize>()), (39, 200));
        for run in sizes.keys() {
            if let Recording::Scenes(first, last) = run {
                assert!(
                    [155, 157, 170]
                        .iter()
                        .all(|cut| !(first < cut && cut <= last))
                );
            }
        }
        let largest = sizes.values().max();
        assert_eq!(largest, Some(&29));
        let drives: Vec<_> = kitti2015_origin()
            .iter()
            .flatten()
            .map(|f| f.drive)
            .collect();
        assert!(drives.is_sorted(), "blocks by drive");
    }
}
