//! The prepared set: a folder that `prep` writes and `train` and `bench` read.
//!
//! ```text
//! manifest.yaml                    what it is; written last, so a set without it is unfinished
//! train.csv  val.csv  test.csv     one line per sample
//! failures.csv                     only if something failed
//! images/<drive>/left|right/*.png  network-size pairs
//! full/...  depth/...  labels/...  full-resolution originals, EXR ground truth, label maps
//! ```
//!
//! The CSV files name every file with its BLAKE3, and the manifest carries a digest of the
//! CSV files, so the manifest's digest identifies the whole content.

use std::collections::BTreeMap;
use std::fmt;
use std::path::{Component, Path, PathBuf};

use serde::{Deserialize, Serialize};
use strat_splits::{Role, Split};

use crate::error::{Error, Result};
use crate::resize::Kernel;
use crate::{files, yaml};

/// The format this version writes and reads.
pub const FORMAT: u32 = 2;

/// File name of the manifest.
pub const MANIFEST: &str = "manifest.yaml";

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
    /// Place and frame: `2011_09_26_drive_0001/0000000005` or `kitti2015/000006`.
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

/// What a set was made of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Content {
    /// The KITTI split, tested on stereo 2015.
    Kitti,
    /// The Eigen split of KITTI raw.
    Eigen,
    /// A user's own rectified stereo pairs.
    Pairs,
    /// The Make3D test images.
    Make3d,
    /// Cityscapes.
    Cityscapes,
}

impl Content {
    /// All kinds.
    pub const ALL: [Self; 5] = [
        Self::Kitti,
        Self::Eigen,
        Self::Pairs,
        Self::Make3d,
        Self::Cityscapes,
    ];

    /// The name in manifests and configurations.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Kitti => "kitti",
            Self::Eigen => "eigen",
            Self::Pairs => "pairs",
            Self::Make3d => "make3d",
            Self::Cityscapes => "cityscapes",
        }
    }

    /// The split of KITTI it is, if it is one.
    pub fn split(self) -> Option<Split> {
        match self {
            Self::Kitti => Some(Split::Kitti),
            Self::Eigen => Some(Split::Eigen),
            Self::Pairs | Self::Make3d | Self::Cityscapes => None,
        }
    }
}

impl From<Split> for Content {
    fn from(split: Split) -> Self {
        match split {
            Split::Kitti => Self::Kitti,
            Split::Eigen => Self::Eigen,
        }
    }
}

impl fmt::Display for Content {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}

/// Samples a role should have and has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Count {
    /// Samples the split has in this role.
    pub expected: u64,
    /// Samples in this set.
    pub found: u64,
}

/// A camera that took some of the images.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraEntry {
    /// Recording day or another name of the rig.
    pub name: String,
    /// Width in pixels of its images.
    pub width: u32,
    /// Height in pixels of its images.
    pub height: u32,
    /// Focal length in pixels.
    pub focal_px: f64,
    /// Stereo baseline in metres.
    pub baseline_m: f64,
}

/// What a set is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// Version of this layout, see [`FORMAT`].
    pub format: u32,
    /// What it was made of: a split of KITTI or another collection.
    pub content: Content,
    /// Digest of that split's lists; collections that are no split of KITTI have none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub split_digest: Option<String>,
    /// `kitti` for recorded, `rendered` for synthetic data, else the name of the collection.
    pub source: String,
    /// Width in pixels of the network-size images.
    pub image_width: u32,
    /// Height in pixels of the network-size images.
    pub image_height: u32,
    /// Kernel that made the network-size images.
    pub kernel: Kernel,
    /// How they are stored: `png`, or `jpeg-92` with the quality.
    pub codec: String,
    /// Samples expected and found per role.
    pub counts: BTreeMap<Role, Count>,
    /// Inputs that could not be used; they are listed in `failures.csv`.
    pub failures: u64,
    /// The cameras.
    pub cameras: Vec<CameraEntry>,
    /// Version of the program that wrote it.
    pub tool_version: String,
    /// BLAKE3 over the sample tables, and so over all content.
    pub data_digest: String,
}

impl Manifest {
    /// Whether a role has all samples of its split.
    pub fn is_complete(&self, role: Role) -> bool {
        self.counts
            .get(&role)
            .is_some_and(|count| count.found == count.expected)
    }
}

/// A finished set on disk.
#[derive(Debug, Clone)]
pub struct PreparedSet {
    /// The folder.
    pub root: PathBuf,
    /// Its manifest.
    pub manifest: Manifest,
}

/// An optional file column of a table.
struct FileColumn {
    get: fn(&Sample) -> &Option<FileRef>,
    set: fn(&mut Sample) -> &mut Option<FileRef>,
}

macro_rules! file_columns {
    ($($name:ident),*) => {
        [$((stringify!($name), FileColumn { get: |s| &s.$name, set: |s| &mut s.$name })),*]
    };
}

/// Names of the optional file columns and access to them, in the order of the table.
const OPTIONAL_FILES: [(&str, FileColumn); 11] = file_columns![
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

impl PreparedSet {
    /// Opens a finished set and checks that its tables are those the manifest speaks of.
    ///
    /// # Errors
    /// `root` is no folder, has no manifest (not a set, or unfinished), is of another format
    /// version, or its tables were changed.
    pub fn open(root: &Path) -> Result<Self> {
        let wrong = |problem: String| Error::Set {
            path: root.to_owned(),
            problem,
        };
        if !root.is_dir() {
            return Err(wrong(
                "there is no such folder; give the folder that `prep ... --out` wrote".to_owned(),
            ));
        }
        let path = root.join(MANIFEST);
        if !path.is_file() {
            return Err(wrong(format!(
                "it has no {MANIFEST}; give the folder that `prep ... --out` wrote, or run that command \
                 again if it was interrupted"
            )));
        }
        let Format { format } = yaml::load(&path)?;
        if format != FORMAT {
            return Err(wrong(format!(
                "it has format {format} and this program reads format {FORMAT}; prepare it again with this version"
            )));
        }
        let set = Self {
            root: root.to_owned(),
            manifest: yaml::load(&path)?,
        };
        let mut tables = Vec::new();
        for role in Role::ALL {
            tables.push((role, files::read(&table_path(root, role))?));
        }
        if data_digest(&tables) != set.manifest.data_digest {
            return Err(wrong(format!(
                "its tables (train.csv, val.csv, test.csv) are not those of {MANIFEST}: a run was interrupted \
                 or a file edited; run the `prep` command again"
            )));
        }
        Ok(set)
    }

    /// The samples of a role in the order of the split.
    ///
    /// # Errors
    /// The table cannot be read or has a bad line, which is named.
    pub fn samples(&self, role: Role) -> Result<Vec<Sample>> {
        let path = table_path(&self.root, role);
        parse_table(&path, &files::read(&path)?)
    }

    /// Where a file of the set is.
    pub fn path(&self, file: &FileRef) -> PathBuf {
        let mut path = self.root.clone();
        path.extend(file.path.split('/'));
        path
    }

    /// Writes the tables and, last, the manifest with `data_digest` filled in. All roles get a table.
    ///
    /// # Errors
    /// A file cannot be written.
    pub fn write(
        root: &Path,
        mut manifest: Manifest,
        samples: &BTreeMap<Role, Vec<Sample>>,
    ) -> Result<Self> {
        let tables: Vec<_> = Role::ALL
            .into_iter()
            .map(|role| {
                (
                    role,
                    table_bytes(samples.get(&role).map_or(&[][..], Vec::as_slice)),
                )
            })
            .collect();
        manifest.data_digest = data_digest(&tables);
        for (role, bytes) in &tables {
            files::write_atomic(&table_path(root, *role), bytes)?;
        }
        files::write_atomic(&root.join(MANIFEST), yaml::to_string(&manifest)?.as_bytes())?;
        Ok(Self {
            root: root.to_owned(),
            manifest,
        })
    }
}

/// Looked at before the rest, whose keys other versions may not share.
#[derive(Deserialize)]
struct Format {
    format: u32,
}

fn table_path(root: &Path, role: Role) -> PathBuf {
    root.join(format!("{role}.csv"))
}

fn data_digest(tables: &[(Role, Vec<u8>)]) -> String {
    let mut hasher = blake3::Hasher::new();
    for (role, bytes) in tables {
        hasher
            .update(format!("{role} {}\n", bytes.len()).as_bytes())
            .update(bytes);
    }
    hasher.finalize().to_hex().to_string()
}

fn columns() -> Vec<String> {
    let mut columns: Vec<_> = ["id", "width", "height", "focal_px", "baseline_m"]
        .map(String::from)
        .into();
    let files = ["left"]
        .into_iter()
        .chain(OPTIONAL_FILES.iter().map(|(name, _)| *name));
    columns.extend(files.flat_map(|name| [name.to_owned(), format!("{name}_blake3")]));
    columns
}

fn table_bytes(samples: &[Sample]) -> Vec<u8> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    let mut rows = vec![columns()];
    for sample in samples {
        let mut row = vec![
            sample.id.clone(),
            sample.width.to_string(),
            sample.height.to_string(),
            sample.focal_px.to_string(),
            sample.baseline_m.to_string(),
        ];
        row.extend([sample.left.path.clone(), sample.left.blake3.clone()]);
        for (_, column) in OPTIONAL_FILES {
            match (column.get)(sample) {
                Some(file) => row.extend([file.path.clone(), file.blake3.clone()]),
                None => row.extend([String::new(), String::new()]),
            }
        }
        rows.push(row);
    }
    for row in rows {
        writer
            .write_record(row)
            .expect("rows of equal length can be written into memory");
    }
    writer.into_inner().expect("memory can be written to")
}

fn parse_table(path: &Path, bytes: &[u8]) -> Result<Vec<Sample>> {
    let bad = |line: u64, problem: String| Error::Table {
        path: path.to_owned(),
        line,
        problem,
    };
    let mut reader = csv::Reader::from_reader(bytes);
    let expected = columns();
    let header = reader.headers().map_err(|e| bad(1, e.to_string()))?;
    if !header.iter().eq(&expected) {
        return Err(bad(
            1,
            format!("its columns should be {}", expected.join(",")),
        ));
    }
    let mut samples = Vec::new();
    for record in reader.records() {
        let record =
            record.map_err(|e| bad(e.position().map_or(0, csv::Position::line), e.to_string()))?;
        let line = record.position().map_or(0, csv::Position::line);
        samples.push(parse_row(&record).map_err(|problem| bad(line, problem))?);
    }
    Ok(samples)
}

fn parse_row(record: &csv::StringRecord) -> std::result::Result<Sample, String> {
    let mut fields = record.iter();
    let mut next = || fields.next().unwrap_or_default();
    fn positive<T: std::str::FromStr + PartialOrd + Default>(
        name: &str,
        text: &str,
    ) -> std::result::Result<T, String> {
        let number: Option<T> = text.parse().ok().filter(|n| *n > T::default());
        number.ok_or_else(|| format!("`{name}` should be a positive number, but is `{text}`"))
    }
    let id = next().to_owned();
    if id.is_empty() {
        return Err("`id` is empty".to_owned());
    }
    let (width, height) = (positive("width", next())?, positive("height", next())?);
    let (focal_px, baseline_m) = (
        known_or_zero("focal_px", next())?,
        known_or_zero("baseline_m", next())?,
    );
    let mut file = |name: &str| -> std::result::Result<Option<FileRef>, String> {
        let (path, blake3) = (next(), next());
        if path.is_empty() {
            return Ok(None);
        }
        let inside = !path.contains('\\')
            && Path::new(path)
                .components()
                .all(|c| matches!(c, Component::Normal(_)));
        if !inside {
            return Err(format!(
                "`{name}` should be a path inside the set, but is `{path}`"
            ));
        }
        if blake3.len() != 64 || !blake3.bytes().all(|b| b.is_ascii_hexdigit()) {
            return Err(format!(
                "`{name}_blake3` should have 64 hex digits, but is `{blake3}`"
            ));
        }
        Ok(Some(FileRef {
            path: path.to_owned(),
            blake3: blake3.to_owned(),
        }))
    };
    let left = file("left")?.ok_or("`left` is empty")?;
    let mut sample = Sample::new(id, (width, height), focal_px, baseline_m, left);
    for (name, column) in OPTIONAL_FILES {
        *(column.set)(&mut sample) = file(name)?;
    }
    Ok(sample)
}

/// A length of the camera, or 0 where it is not known.
fn known_or_zero(name: &str, text: &str) -> std::result::Result<f64, String> {
    let number = text
        .parse()
        .ok()
        .filter(|n: &f64| n.is_finite() && *n >= 0.0);
    number.ok_or_else(|| {
        format!("`{name}` should be a positive number, or 0 if it is not known, but is `{text}`")
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(path: &str) -> FileRef {
        FileRef {
            path: path.to_owned(),
            blake3: files::blake3_hex(path.as_bytes()),
        }
    }

    fn sample(id: &str) -> Sample {
        // The baseline is not a short decimal: it must survive being written as text.
        let left = file("images/d/left/0000000005.png");
        Sample {
            right: Some(file("images/d/right/0000000005.png")),
            left_full: Some(file("full/d/left/0000000005.jpg")),
            depth_velodyne: Some(file("depth/velodyne/d/0000000005.exr")),
            instance: Some(file("labels/instance/1.png")),
            ..Sample::new(id, (1242, 375), 721.5377, 0.1 + 0.2, left)
        }
    }

    fn manifest() -> Manifest {
        Manifest {
            format: FORMAT,
            content: Content::Eigen,
            split_digest: Some(strat_splits::digest(Split::Eigen)),
            source: "kitti".to_owned(),
            image_width: 512,
            image_height: 256,
            kernel: Kernel::Area,
            codec: "png".to_owned(),
            counts: [
                (
                    Role::Train,
                    Count {
                        expected: 3,
                        found: 2,
                    },
                ),
                (
                    Role::Val,
                    Count {
                        expected: 0,
                        found: 0,
                    },
                ),
            ]
            .into(),
            failures: 1,
            cameras: vec![CameraEntry {
                name: "2011_09_26".to_owned(),
                width: 1242,
                height: 375,
                focal_px: 721.5377,
                baseline_m: 0.532_725_428,
            }],
            tool_version: "0.1.0".to_owned(),
            data_digest: String::new(),
        }
    }

    fn written(root: &Path) -> PreparedSet {
        let samples = [(Role::Train, vec![sample("a/1"), sample("a/2")])].into();
        PreparedSet::write(root, manifest(), &samples).unwrap()
    }

    #[test]
    fn a_set_comes_back_as_written() {
        let folder = tempfile::tempdir().unwrap();
        let set = written(folder.path());
        assert_eq!(set.manifest.data_digest.len(), 64);
        let opened = PreparedSet::open(folder.path()).unwrap();
        assert_eq!(opened.manifest, set.manifest);
        assert_eq!(
            opened.samples(Role::Train).unwrap(),
            [sample("a/1"), sample("a/2")]
        );
        assert!(opened.samples(Role::Test).unwrap().is_empty());
        assert!(
            !opened.manifest.is_complete(Role::Train) && opened.manifest.is_complete(Role::Val)
        );
        assert!(
            !opened.manifest.is_complete(Role::Test),
            "a role without a count is not complete"
        );
        assert_eq!(
            opened.path(&file("full/d/x.png")),
            folder.path().join("full").join("d").join("x.png")
        );
        let text = std::fs::read_to_string(folder.path().join(MANIFEST)).unwrap();
        assert!(
            text.contains("content: eigen")
                && text.contains("kernel: area")
                && text.contains("train:"),
            "{text}"
        );
    }

    #[test]
    fn the_digest_follows_the_rows_and_their_roles() {
        let folder = tempfile::tempdir().unwrap();
        let digest = |role, samples| {
            let samples = [(role, samples)].into();
            PreparedSet::write(folder.path(), manifest(), &samples)
                .unwrap()
                .manifest
                .data_digest
        };
        let one = digest(Role::Train, vec![sample("a/1")]);
        assert_eq!(one, digest(Role::Train, vec![sample("a/1")]));
        assert_ne!(one, digest(Role::Val, vec![sample("a/1")]));
        let mut other = sample("a/1");
        other.left.blake3 = files::blake3_hex(b"other pixels");
        assert_ne!(one, digest(Role::Train, vec![other]));
    }

    #[test]
    fn what_is_no_finished_set_is_explained() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path();
        let problem = || PreparedSet::open(root).unwrap_err().to_string();
        let missing = PreparedSet::open(&root.join("none"))
            .unwrap_err()
            .to_string();
        assert!(
            missing.contains("none") && missing.contains("no such folder"),
            "{missing}"
        );
        assert!(problem().contains("has no manifest.yaml"));

        written(root);
        let path = root.join(MANIFEST);
        let text = std::fs::read_to_string(&path).unwrap();
        std::fs::write(&path, text.replace("format: 2", "format: 3\nnews: 1")).unwrap();
        assert!(problem().contains("format 3"), "{}", problem());
        std::fs::write(&path, text.replace("kernel: area", "kernel: cubic")).unwrap();
        assert!(
            problem().contains("kernel") && problem().contains("line"),
            "{}",
            problem()
        );
        std::fs::write(&path, &text).unwrap();
        std::fs::write(root.join("train.csv"), b"").unwrap();
        assert!(problem().contains("interrupted"), "{}", problem());
    }

    #[test]
    fn bad_lines_are_named() {
        let good = String::from_utf8(table_bytes(&[sample("a/1"), sample("a/2")])).unwrap();
        let parse = |text: String| parse_table(Path::new("train.csv"), text.as_bytes());
        assert_eq!(parse(good.clone()).unwrap().len(), 2);
        let cases = [
            (
                good.replacen("focal_px", "focal", 1),
                1,
                "columns should be",
            ),
            (
                good.replacen("a/2,1242", "a/2,-4", 1),
                3,
                "`width` should be a positive number, but is `-4`",
            ),
            (good.replacen("721.5377", "NaN", 1), 2, "focal_px"),
            (good.replacen("721.5377", "inf", 1), 2, "focal_px"),
            (
                good.replacen("721.5377", "-1", 1),
                2,
                "0 if it is not known",
            ),
            (
                good.replacen("images/d/left", "../../etc", 1),
                2,
                "path inside the set",
            ),
            (
                good.replacen("images/d/left", "/images/d/left", 1),
                2,
                "path inside the set",
            ),
            (good.replacen("a/2,1242", "a/2", 1), 3, "fields"),
            (good.replacen("a/1,", ",", 1), 2, "`id` is empty"),
        ];
        for (text, line, problem) in cases {
            let error = parse(text).unwrap_err().to_string();
            assert!(
                error.starts_with(&format!("train.csv, line {line}: ")) && error.contains(problem),
                "{error}"
            );
        }
        let hash = files::blake3_hex(b"images/d/left/0000000005.png");
        assert!(
            parse(good.replacen(&hash, "123", 1))
                .unwrap_err()
                .to_string()
                .contains("64 hex digits")
        );
    }
}
