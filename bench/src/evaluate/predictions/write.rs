//! Saves predictions as a NumPy array, so that any other program can score the very same ones.
//!
//! `predictions.npy` is `[images, height, width]`, little-endian `f32`, row-major: disparity of
//! the left image as a fraction of image width at network size, before any resizing, floor or
//! clip. `predictions.ids.txt` names the images, one per line in the same order, and
//! `predictions.yaml` says what the numbers are: what [`crate::evaluate::predictions`] reads. Images that failed
//! are in none.

use std::{
    io::{self, BufWriter, Seek, SeekFrom, Write},
    path::{Path, PathBuf},
};

use strat_onnx::metadata::OutputMeaning;
use strat_store::{files, raster::Plane};
use tempfile::NamedTempFile;

use crate::evaluate::predictions::SavedDescription;

/// Bytes of the array's header; fixed, so that it can be rewritten when the count is known.
const HEADER_BYTES: usize = 128;

/// Why predictions could not be saved.
#[derive(Debug, thiserror::Error)]
pub enum SaveError {
    /// The system refused.
    #[error("predictions cannot be written to {}: {reason}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's answer.
        reason: io::Error,
    },
    /// The model gives depth, not disparity.
    #[error(
        "the model gives depth in metres, but predictions are saved as disparity fractions; \
         leave out --save-predictions"
    )]
    NotDisparity,
    /// Two predictions of one model differ in size.
    #[error("the prediction for {image} is {width}x{height}, unlike those before it")]
    SizeChanged {
        /// Image id.
        image: String,
        /// Its width.
        width: usize,
        /// Its height.
        height: usize,
    },
    /// The list of ids could not be written.
    #[error(transparent)]
    Store(#[from] strat_store::Error),
}

/// Writes an array of which the length is known only at the end.
pub struct PredictionWriter {
    path: PathBuf,
    file: BufWriter<NamedTempFile>,
    /// Width and height of every prediction, from the first one on.
    size: Option<(usize, usize)>,
    ids: String,
    count: usize,
}

impl PredictionWriter {
    /// Begins `path` (a `.npy` file), which appears only when [`finish`](Self::finish) is called.
    ///
    /// # Errors
    /// The folder cannot be written to.
    pub fn create(path: &Path) -> Result<Self, SaveError> {
        let begin = || -> io::Result<BufWriter<NamedTempFile>> {
            let folder = path.parent().unwrap_or(Path::new("."));
            let mut file = tempfile::Builder::new()
                .prefix(files::UNFINISHED_PREFIX)
                .tempfile_in(folder)?;
            file.write_all(&[0; HEADER_BYTES])?;
            Ok(BufWriter::new(file))
        };
        Ok(Self {
            file: begin().map_err(|reason| SaveError::Io {
                path: path.to_path_buf(),
                reason,
            })?,
            path: path.to_path_buf(),
            size: None,
            ids: String::new(),
            count: 0,
        })
    }

    /// Adds one prediction.
    ///
    /// # Errors
    /// The disk is full, there is no disparity, or it has another size than those before it.
    pub fn push(
        &mut self,
        image: &str,
        disparity_fraction: Option<&Plane>,
    ) -> Result<(), SaveError> {
        let disparity_fraction = disparity_fraction.ok_or(SaveError::NotDisparity)?;
        let (width, height) = (disparity_fraction.width, disparity_fraction.height);
        if *self.size.get_or_insert((width, height)) != (width, height) {
            return Err(SaveError::SizeChanged {
                image: image.to_owned(),
                width,
                height,
            });
        }
        for value in &disparity_fraction.data {
            self.file
                .write_all(&value.to_le_bytes())
                .map_err(|reason| SaveError::Io {
                    path: self.path.clone(),
                    reason,
                })?;
        }
        self.ids.push_str(image);
        self.ids.push('\n');
        self.count += 1;
        Ok(())
    }

    /// Completes the array and writes ids (`NAME.ids.txt`) and description (`NAME.yaml`) beside it.
    ///
    /// # Errors
    /// The files cannot be written.
    pub fn finish(self) -> Result<(), SaveError> {
        let Self {
            path,
            file,
            size,
            ids,
            count,
        } = self;
        let (width, height) = size.unwrap_or_default();
        let end = || -> io::Result<()> {
            let mut file = file.into_inner().map_err(io::IntoInnerError::into_error)?;
            file.seek(SeekFrom::Start(0))?;
            file.write_all(&header(count, height, width))?;
            file.persist(&path).map_err(|error| error.error)?;
            Ok(())
        };
        end().map_err(|reason| SaveError::Io {
            path: path.clone(),
            reason,
        })?;
        files::write_atomic(&path.with_extension("ids.txt"), ids.as_bytes())?;
        let description = SavedDescription::plain(OutputMeaning::DisparityFraction);
        let text = strat_store::yaml::to_string(&description)?;
        files::write_atomic(&path.with_extension("yaml"), text.as_bytes())?;
        Ok(())
    }
}

/// Header of NumPy's format 1.0, padded with spaces to a fixed length.
fn header(count: usize, height: usize, width: usize) -> Vec<u8> {
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    let length = HEADER_BYTES - bytes.len() - 2;
    bytes.extend((length as u16).to_le_bytes());
    let text = format!(
        "{{'descr': '<f4', 'fortran_order': False, 'shape': ({count}, {height}, {width}), }}"
    );
    bytes.extend(text.bytes());
    bytes.resize(HEADER_BYTES - 1, b' ');
    bytes.push(b'\n');
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_array_reads_back() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("predictions.npy");
        let mut writer = PredictionWriter::create(&path).unwrap();
        let plane = |start: f32| Plane {
            width: 3,
            height: 2,
            data: (0..6_u8).map(|i| start + f32::from(i)).collect(),
        };
        writer.push("a/1", Some(&plane(0.0))).unwrap();
        assert!(!path.exists());
        writer.push("a/2", Some(&plane(10.0))).unwrap();
        writer.finish().unwrap();
        // An independent reader of the format.
        let array: ndarray::Array3<f32> = ndarray_npy::read_npy(&path).unwrap();
        assert_eq!(array.shape(), [2, 2, 3]);
        assert_eq!(array[[1, 1, 2]], 15.0);
        let ids = std::fs::read_to_string(folder.path().join("predictions.ids.txt")).unwrap();
        assert_eq!(ids, "a/1\na/2\n");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 3);
    }

    #[test]
    fn sizes_must_agree() {
        let folder = tempfile::tempdir().unwrap();
        let mut writer = PredictionWriter::create(&folder.path().join("p.npy")).unwrap();
        let plane = |width| Plane {
            width,
            height: 1,
            data: vec![0.0; width],
        };
        writer.push("a", Some(&plane(2))).unwrap();
        assert!(matches!(
            writer.push("b", Some(&plane(3))),
            Err(SaveError::SizeChanged { .. })
        ));
        assert!(matches!(
            writer.push("c", None),
            Err(SaveError::NotDisparity)
        ));
    }
}
