//! NumPy and MATLAB arrays, saved predictions with the list of their images, and lists in archives.
#![no_main]

mod damage;

use std::io::Write;
use std::path::Path;
use std::sync::LazyLock;

use libfuzzer_sys::fuzz_target;
use strat_bench::evaluate::predictions::SavedPredictions;
use strat_prep::input::{mat, source};
use strat_store::npy;
use strat_store::set::{Content, FileRef, Sample};
use tempfile::TempDir;

static NPY: LazyLock<Vec<u8>> = LazyLock::new(|| npy::encode(3, 2, &[0.25; 6]));
const DESCRIPTION: &str = "meaning: disparity_fraction\n";
static FOLDER: LazyLock<TempDir> = LazyLock::new(|| {
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("p.yaml"), DESCRIPTION).expect("written");
    folder
});

/// A level 5 MAT-file's header and one small matrix of doubles, not compressed.
fn matrix() -> Vec<u8> {
    let mut bytes = vec![b' '; 124];
    bytes.extend([0x00, 0x01, b'I', b'M']);
    let mut body = Vec::new();
    body.extend([6, 0, 0, 0, 8, 0, 0, 0, 6, 0, 0, 0, 0, 0, 0, 0]);
    body.extend([5, 0, 0, 0, 8, 0, 0, 0, 2, 0, 0, 0, 1, 0, 0, 0]);
    body.extend([1, 0, 0, 0, 1, 0, 0, 0, b'x', 0, 0, 0, 0, 0, 0, 0]);
    body.extend([9, 0, 0, 0, 16, 0, 0, 0]);
    body.extend([1.5_f64, 2.5].iter().flat_map(|value| value.to_le_bytes()));
    bytes.extend([14, 0, 0, 0]);
    bytes.extend((body.len() as u32).to_le_bytes());
    bytes.extend(body);
    bytes
}

/// An archive with one array, not compressed.
static NPZ: LazyLock<Vec<u8>> = LazyLock::new(|| {
    let mut zip = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    let options =
        zip::write::SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
    zip.start_file("x.npy", options).expect("an entry");
    zip.write_all(&NPY).expect("its bytes");
    zip.finish().expect("an archive").into_inner()
});

/// Reads a map as `bench` does.
fn saved(path: &Path) {
    let samples = [sample()];
    if let Ok(saved) = SavedPredictions::open("x", path, Content::Pairs, &samples)
        && let Ok(map) = saved.map("a/1")
    {
        assert_eq!(map.width * map.height, map.data.len());
        assert!(map.data.iter().all(|value| value.is_finite()));
    }
}

fn sample() -> Sample {
    let file = FileRef {
        path: "x".to_owned(),
        blake3: String::new(),
    };
    Sample::new("a/1", (4, 4), 1.0, 1.0, file)
}

fuzz_target!(|data: &[u8]| {
    let Some((which, data)) = data.split_first() else {
        return;
    };
    match which % 6 {
        0 => {
            if let Ok(array) = npy::decode(&damage::damaged(&NPY, data)) {
                assert_eq!(array.width * array.height, array.values.len());
            }
        }
        1 => {
            if let Ok(read) = mat::read(&damage::damaged(&matrix(), data), "x") {
                let _ = format!("{read:?}").len();
            }
        }
        2 => {
            let path = FOLDER.path().join("p.npy");
            std::fs::write(&path, damage::damaged(&NPY, data)).expect("written");
            saved(&path);
        }
        3 => {
            let path = FOLDER.path().join("p.npz");
            std::fs::write(&path, damage::damaged(&NPZ, data)).expect("written");
            saved(&path);
        }
        4 => {
            let path = FOLDER.path().join("i.npy");
            std::fs::write(&path, &*NPY).expect("written");
            let ids = damage::damaged(b"a/1\n", data);
            std::fs::write(FOLDER.path().join("i.ids.txt"), ids).expect("written");
            std::fs::write(FOLDER.path().join("i.yaml"), DESCRIPTION).expect("written");
            saved(&path);
        }
        _ => {
            let path = FOLDER.path().join("p.zip");
            std::fs::write(&path, data).expect("written");
            for entry in source::entries(&path, |_| true).unwrap_or_default() {
                let _ = entry.name().len();
            }
        }
    }
});
