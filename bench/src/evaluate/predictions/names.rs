//! How the published lists and the folders of other programs name the images of KITTI.
//!
//! Only names that say drive and frame, or the number of a stereo 2015 scene, are understood; a list
//! that only counts is matched by its length, elsewhere.

use strat_splits::{DriveId, FrameId};

/// The id of an image that a line of a list names, in the forms of monodepth
/// (`2011_09_26/2011_09_26_drive_0002_sync/image_02/data/0000000069.jpg ...`), monodepth2
/// (`2011_09_26/2011_09_26_drive_0002_sync 0000000069 l`), BTS
/// (`..._sync/image_02/data/0000000069.png ..._sync/proj_depth/... 721.5`) and stereo 2015
/// (`training/image_2/000006_10.png`). Other lines are ids themselves.
pub fn id_of_line(line: &str) -> String {
    let line = line.trim();
    frame(line)
        .or_else(|| scene(line))
        .unwrap_or_else(|| line.to_owned())
}

/// The first drive and the first frame number that a line names.
fn frame(line: &str) -> Option<String> {
    let mut parts = line.split(['/', '\\', ' ', '\t']);
    let drive: DriveId = parts.find_map(|part| part.parse().ok())?;
    let index = parts.find_map(|part| {
        let stem = stem(part);
        let digits = !stem.is_empty() && stem.bytes().all(|byte| byte.is_ascii_digit());
        if digits { stem.parse().ok() } else { None }
    })?;
    Some(FrameId { drive, index }.to_string())
}

fn scene(line: &str) -> Option<String> {
    let file = line.split(['/', '\\']).next_back()?;
    let number = stem(file).strip_suffix("_10")?;
    (number.len() == 6 && number.bytes().all(|byte| byte.is_ascii_digit())).then_some(())?;
    Some(format!("kitti2015/{number}"))
}

fn stem(file: &str) -> &str {
    file.split_once('.').map_or(file, |(stem, _)| stem)
}

/// Names, without extension, under which the map of an image may lie in a folder: its id, with `/`
/// or `_` in it, as BTS has it (`2011_09_26_drive_0002_sync_0000000069`), and as the devkit of stereo
/// 2015 has it (`000006_10`).
pub fn stems_of(id: &str) -> Vec<String> {
    let mut stems = vec![id.to_owned(), id.replace('/', "_")];
    if let Some((place, frame)) = id.split_once('/') {
        if place.parse::<DriveId>().is_ok() {
            stems.push(format!("{place}_sync/{frame}"));
            stems.push(format!("{place}_sync_{frame}"));
        } else if place == "kitti2015" {
            stems.push(format!("{frame}_10"));
            stems.push(format!("{id}_10"));
        }
    }
    stems
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn published_lines_name_their_image() {
        let frame = "2011_09_26_drive_0002/0000000069";
        for line in [
            frame,
            "  2011_09_26_drive_0002/0000000069 ",
            "2011_09_26/2011_09_26_drive_0002_sync 0000000069 l",
            "2011_09_26/2011_09_26_drive_0002_sync 69 l",
            "2011_09_26/2011_09_26_drive_0002_sync/image_02/data/0000000069.jpg \
             2011_09_26/2011_09_26_drive_0002_sync/image_03/data/0000000069.jpg",
            "2011_09_26/2011_09_26_drive_0002_sync/image_02/data/0000000069.png \
             2011_09_26_drive_0002_sync/proj_depth/groundtruth/image_02/0000000069.png 721.5377",
            "2011_09_26/2011_09_26_drive_0002_sync/image_02/data/0000000069.png None 721.5377",
            "2011_09_26\\2011_09_26_drive_0002_sync\\image_02\\data\\0000000069.png",
        ] {
            assert_eq!(id_of_line(line), frame, "{line}");
        }
        for line in [
            "kitti2015/000006",
            "training/image_2/000006_10.png",
            "000006_10.png",
            "000006_10",
        ] {
            assert_eq!(id_of_line(line), "kitti2015/000006", "{line}");
        }
        for line in [
            "make3d/op10-p-313t000",
            "links/Bild 1",
            "",
            "0000000069.png",
            "a_10",
        ] {
            assert_eq!(id_of_line(line), line, "{line}");
        }
    }

    #[test]
    fn folders_of_other_programs_name_their_images() {
        let stems = stems_of("2011_09_26_drive_0002/0000000069");
        assert!(stems.contains(&"2011_09_26_drive_0002_sync_0000000069".to_owned()));
        assert!(stems.contains(&"2011_09_26_drive_0002_0000000069".to_owned()));
        assert!(stems_of("kitti2015/000006").contains(&"000006_10".to_owned()));
        assert_eq!(stems_of("a"), ["a", "a"]);
    }
}
