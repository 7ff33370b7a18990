//! Where an input comes from: a file, or an entry of a zip archive read in place.
//!
//! KITTI is handed out as zip archives, and everything `prep` reads it reads once, so unpacking
//! them would only cost a second copy on disk. The central directory of an archive is read once;
//! of every entry its place is kept (a few dozen bytes), and reading one opens the archive, goes
//! there and inflates. So any number of threads read at the same time, and no memory grows with
//! the size of an archive.
//!
//! Names in archives are only compared with those KITTI uses and never become paths, so an entry
//! called `../x` or `/x` cannot reach anything; such names are passed over.

use std::fmt;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::SystemTime;

use strat_store::guard::guarded;
use strat_store::image_files;
use strat_store::inputs::{self, Kind};
use zip::{CompressionMethod, ZipArchive};

/// Bytes of a file read at once by [`Source::read_in_pieces`]; whole points of a scan.
const PIECE: usize = 64 << 10;

/// First bytes and length of a local file header (APPNOTE.TXT 4.3.7).
const LOCAL_HEADER: (&[u8], usize) = (b"PK\x03\x04", 30);

/// One input file.
#[derive(Debug, Clone)]
pub enum Source {
    /// A file of its own.
    File(PathBuf),
    /// A file inside an archive.
    Entry(Entry),
}

/// A zip archive.
#[derive(Debug)]
struct Archive {
    path: PathBuf,
    changed: Option<SystemTime>,
}

/// A file inside a zip archive.
#[derive(Debug, Clone)]
pub struct Entry {
    archive: Arc<Archive>,
    name: Box<str>,
    header: u64,
    packed: u64,
    size: u64,
    crc32: u32,
    packing: Packing,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Packing {
    Stored,
    Deflated,
    Encrypted,
    Unknown,
}

impl Source {
    /// The whole content, which should be of this kind.
    ///
    /// # Errors
    /// The file cannot be read, or the entry is damaged, or either is larger than its kind; the message
    /// names it.
    pub fn read(&self, kind: Kind) -> strat_store::Result<Vec<u8>> {
        match self {
            Self::File(path) => inputs::read(path, kind),
            Self::Entry(entry) => {
                let name = PathBuf::from(self.to_string());
                kind.check(&name, entry.size.max(entry.packed))?;
                entry.read().map_err(|source| strat_store::Error::Io {
                    action: "read",
                    path: name,
                    source,
                })
            }
        }
    }

    /// The whole content of a scan in order, piece by piece: of a file, in pieces small enough to stay in the
    /// caches until `take` is done with them.
    ///
    /// # Errors
    /// As [`Source::read`]; pieces may have been taken before.
    pub fn read_in_pieces(&self, mut take: impl FnMut(&[u8])) -> strat_store::Result<()> {
        let Self::File(path) = self else {
            take(&self.read(Kind::Scan)?);
            return Ok(());
        };
        let mut file = inputs::open(path, Kind::Scan)?;
        let mut pieces = || {
            let mut piece = vec![0; PIECE];
            loop {
                match file.read(&mut piece) {
                    Ok(0) => return Ok(()),
                    Ok(length) => take(&piece[..length]),
                    Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
                    Err(e) => return Err(e),
                }
            }
        };
        pieces().map_err(|source| strat_store::Error::Io {
            action: "read",
            path: path.clone(),
            source,
        })
    }

    /// What follows the last dot of its name, in small letters; empty if there is no dot.
    pub fn extension(&self) -> String {
        let name = match self {
            Self::File(path) => path.file_name().and_then(|n| n.to_str()).unwrap_or(""),
            Self::Entry(entry) => &entry.name,
        };
        let extension = name.rsplit_once('.').map_or("", |(_, extension)| extension);
        extension.to_lowercase()
    }

    /// Width and height in pixels of an image; of a file, from its first bytes alone.
    ///
    /// # Errors
    /// It cannot be read or is no image; the message names it.
    pub fn image_size(&self) -> strat_store::Result<(u32, u32)> {
        match self {
            Self::File(path) => image_files::read_size(path),
            Self::Entry(_) => image_files::decode_size(&self.read(Kind::Image)?, &self.to_string()),
        }
    }

    /// Whether it is a file of its own, which counts more than a copy in an archive.
    pub fn is_file(&self) -> bool {
        matches!(self, Self::File(_))
    }

    /// Bytes of its content; 0 where that cannot be told.
    pub fn len(&self) -> u64 {
        match self {
            Self::File(path) => std::fs::metadata(path).map_or(0, |m| m.len()),
            Self::Entry(entry) => entry.size,
        }
    }

    /// Whether it has no content.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// When it was last written or put into its place; of an entry, its archive. `None` where the
    /// file system does not say.
    pub fn changed(&self) -> Option<SystemTime> {
        match self {
            Self::File(path) => changed(&std::fs::metadata(path).ok()?),
            Self::Entry(entry) => entry.archive.changed,
        }
    }
}

impl fmt::Display for Source {
    /// `folder/frame.png`, or `folder/archive.zip: frame.png`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File(path) => path.display().fmt(f),
            Self::Entry(entry) => write!(f, "{}: {}", entry.archive.path.display(), entry.name),
        }
    }
}

impl From<PathBuf> for Source {
    fn from(path: PathBuf) -> Self {
        Self::File(path)
    }
}

impl Entry {
    /// Its name in the archive, with `/` between its parts.
    pub fn name(&self) -> &str {
        &self.name
    }

    fn read(&self) -> io::Result<Vec<u8>> {
        let wrong = |problem: String| io::Error::new(io::ErrorKind::InvalidData, problem);
        match self.packing {
            Packing::Stored | Packing::Deflated => {}
            Packing::Encrypted => return Err(wrong("it is encrypted".to_owned())),
            Packing::Unknown => {
                return Err(wrong(
                    "it is packed by a method other than deflate; unpack the archive".to_owned(),
                ));
            }
        }
        let mut file = File::open(&self.archive.path)?;
        file.seek(SeekFrom::Start(self.header))?;
        let mut header = [0; LOCAL_HEADER.1];
        file.read_exact(&mut header).map_err(cut_off)?;
        if !header.starts_with(LOCAL_HEADER.0) {
            return Err(wrong(
                "the archive is damaged: no file begins where its directory says".to_owned(),
            ));
        }
        let length = |at: usize| i64::from(u16::from_le_bytes([header[at], header[at + 1]]));
        file.seek(SeekFrom::Current(length(26) + length(28)))?;
        let mut packed = vec![0; self.packed as usize];
        file.read_exact(&mut packed).map_err(cut_off)?;
        let content = if self.packing == Packing::Deflated {
            let mut content = Vec::with_capacity(self.size as usize);
            // One byte more than promised is enough to see a false promise.
            let mut inflate = flate2::read::DeflateDecoder::new(&*packed).take(self.size + 1);
            guarded("the zip reader", || inflate.read_to_end(&mut content))
                .map_err(wrong)?
                .map_err(|e| wrong(format!("the archive is damaged here ({e})")))?;
            content
        } else {
            packed
        };
        if content.len() as u64 != self.size || crc32fast::hash(&content) != self.crc32 {
            return Err(wrong(
                "the archive is damaged here: length or checksum differ".to_owned(),
            ));
        }
        Ok(content)
    }
}

fn cut_off(error: io::Error) -> io::Error {
    match error.kind() {
        io::ErrorKind::UnexpectedEof => io::Error::new(
            io::ErrorKind::InvalidData,
            "the archive ends before it; download it again",
        ),
        _ => error,
    }
}

/// The files of an archive that `wanted` accepts by name, in the order of the archive.
///
/// # Errors
/// It cannot be read or is not a whole zip archive, as a sentence that names it.
pub fn entries(path: &Path, wanted: impl Fn(&str) -> bool) -> Result<Vec<Entry>, String> {
    let file = inputs::open(path, Kind::Archive).map_err(|e| e.to_string())?;
    let changed = file.metadata().ok().and_then(|m| changed(&m));
    let damaged = |problem: &dyn fmt::Display| {
        format!(
            "{} is not a whole zip archive ({problem}); download it again",
            path.display()
        )
    };
    let file = io::BufReader::with_capacity(1 << 16, file);
    let zip = guarded("the zip reader", || ZipArchive::new(file))
        .map_err(|problem| damaged(&problem))?
        .map_err(|e| damaged(&e))?;
    let archive = Arc::new(Archive {
        path: path.to_owned(),
        changed,
    });
    let mut entries = Vec::new();
    for index in 0..zip.len() {
        let entry = zip.by_index_data(index).map_err(|e| damaged(&e))?;
        // A name that is no text is none of KITTI's.
        let Ok(name) = entry.name() else { continue };
        // Some programs on Windows write their own separator, against the format (APPNOTE.TXT 4.4.17).
        let name = name.replace('\\', "/");
        let odd = |part: &str| matches!(part, "" | "." | "..") || part.contains(':');
        if !entry.is_file() || name.split('/').any(odd) || !wanted(&name) {
            continue;
        }
        let packing = match entry.compression() {
            _ if entry.encrypted() => Packing::Encrypted,
            CompressionMethod::Stored => Packing::Stored,
            CompressionMethod::Deflated => Packing::Deflated,
            _ => Packing::Unknown,
        };
        entries.push(Entry {
            archive: Arc::clone(&archive),
            name: name.into(),
            header: entry.header_start(),
            packed: entry.compressed_size(),
            size: entry.size(),
            crc32: entry.crc32(),
            packing,
        });
    }
    Ok(entries)
}

/// Whether a name ends like a zip archive's.
pub fn is_archive(name: &str) -> bool {
    name.len() > 4 && name.as_bytes()[name.len() - 4..].eq_ignore_ascii_case(b".zip")
}

/// The later of writing and of being put into place: a file that replaces another keeps its old
/// time of writing when it is moved or unpacked.
fn changed(metadata: &std::fs::Metadata) -> Option<SystemTime> {
    let written = metadata.modified().ok()?;
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt;
        let placed = u64::try_from(metadata.ctime()).ok()?;
        let nanos = u32::try_from(metadata.ctime_nsec()).ok()?;
        let placed = SystemTime::UNIX_EPOCH + std::time::Duration::new(placed, nanos);
        Some(written.max(placed))
    }
    #[cfg(not(unix))]
    Some(written)
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use zip::write::SimpleFileOptions;

    use super::*;

    fn archive(files: &[(&str, &[u8], CompressionMethod)]) -> (tempfile::TempDir, PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a b ü.zip");
        let mut zip = zip::ZipWriter::new(File::create(&path).unwrap());
        for (name, content, method) in files {
            let options = SimpleFileOptions::default().compression_method(*method);
            zip.start_file(*name, options).unwrap();
            zip.write_all(content).unwrap();
        }
        zip.finish().unwrap();
        (folder, path)
    }

    const LONG: &[u8] = &[7; 5000];

    #[test]
    fn entries_are_read_in_place() {
        let (_folder, path) = archive(&[
            ("a/one.png", b"one", CompressionMethod::Stored),
            ("a/two.bin", LONG, CompressionMethod::Deflated),
            ("a/other", b"", CompressionMethod::Stored),
        ]);
        let found = entries(&path, |name| name.contains('.')).unwrap();
        assert_eq!(found.len(), 2);
        let [one, two] = [0, 1].map(|i| Source::Entry(found[i].clone()));
        assert_eq!(one.read(Kind::Image).unwrap(), b"one");
        assert_eq!(two.read(Kind::Image).unwrap(), LONG);
        assert_eq!((&*one.extension(), two.len()), ("png", 5000));
        assert_eq!(two.to_string(), format!("{}: a/two.bin", path.display()));
    }

    #[test]
    fn names_that_lead_elsewhere_are_passed_over() {
        let names = [
            "../x.png",
            "/x.png",
            "a/../x.png",
            "..\\x.png",
            "a\\..\\x.png",
            "\\x.png",
            "c:/x.png",
            "c:\\x.png",
            "x.png",
            "a\\b\\x.png",
        ];
        let files = names.map(|name| (name, &b"x"[..], CompressionMethod::Stored));
        let (_folder, path) = archive(&files);
        let found = entries(&path, |_| true).unwrap();
        let found: Vec<_> = found.iter().map(Entry::name).collect();
        assert_eq!(found, ["x.png", "a/b/x.png"]);
    }

    #[test]
    fn damage_is_named() {
        let (folder, path) = archive(&[("a/two.bin", LONG, CompressionMethod::Deflated)]);
        let source = Source::Entry(entries(&path, |_| true).unwrap().remove(0));
        let good = std::fs::read(&path).unwrap();
        let damaged = |change: &dyn Fn(&mut Vec<u8>)| {
            let mut bytes = good.clone();
            change(&mut bytes);
            std::fs::write(&path, bytes).unwrap();
            source.read(Kind::Image).unwrap_err().to_string()
        };
        for (problem, part) in [
            (damaged(&|b| b[45] ^= 0x55), "damaged"),
            (damaged(&|b| b[0] = 0), "no file begins"),
            (damaged(&|b| b.truncate(42)), "ends before it"),
            (damaged(&|b| b.truncate(10)), "ends before it"),
        ] {
            assert!(
                problem.contains("a b ü.zip: a/two.bin") && problem.contains(part),
                "{problem}"
            );
        }
        for bytes in [&good[..good.len() / 2], b"PK", b"", b"<html>"] {
            let cut = folder.path().join("cut.zip");
            std::fs::write(&cut, bytes).unwrap();
            let problem = entries(&cut, |_| true).unwrap_err();
            assert!(
                problem.contains("cut.zip is not a whole zip archive"),
                "{problem}"
            );
        }
    }

    #[test]
    fn an_entry_that_is_larger_than_it_says_is_no_way_to_fill_memory() {
        let zeros = vec![0; 1 << 20];
        let (_folder, path) = archive(&[("z.bin", &zeros, CompressionMethod::Deflated)]);
        let mut entry = entries(&path, |_| true).unwrap().remove(0);
        entry.size = 100;
        let problem = entry.read().unwrap_err().to_string();
        assert!(problem.contains("length or checksum differ"), "{problem}");
        entry.size = Kind::Scan.largest() + 1;
        let source = Source::Entry(entry);
        let problem = source.read(Kind::Scan).unwrap_err().to_string();
        assert!(
            problem.contains("a Velodyne scan has at most 64.0 MB"),
            "{problem}"
        );
    }
}
