//! Saves predictions as a NumPy array, so that any other program can score the very same ones.
//!
//! `predictions.npy` is `[images, height, width]`, little-endian `f32`, row-major: disparity of
//! the left image as a fraction of image width at network size, before any resizing, floor or
//! clip. `predictions.ids.txt` names the images, one per line in the same order, and
//! `predictions.yaml` says what the numbers are: what [`crate::evaluate::predictions`] reads. Images
//! that failed are in none.

use std::path::{Path, PathBuf};

use strat_onnx::metadata::OutputMeaning;
use strat_store::{files, npy, raster::Plane};

use crate::evaluate::predictions::SavedDescription;

/// Why predictions could not be saved.
#[derive(Debug, thiserror::Error)]
pub enum SaveError {
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
    /// A file could not be written.
    #[error(transparent)]
    Store(#[from] strat_store::Error),
}

/// Writes an array of which the length is known only at the end.
pub struct PredictionWriter {
    path: PathBuf,
    array: npy::PlaneWriter,
    ids: String,
}

impl PredictionWriter {
    /// Begins `path` (a `.npy` file), which appears only when [`finish`](Self::finish) is called.
    ///
    /// # Errors
    /// The folder cannot be written to.
    pub fn create(path: &Path) -> Result<Self, SaveError> {
        Ok(Self {
            path: path.to_path_buf(),
            array: npy::PlaneWriter::create(path)?,
            ids: String::new(),
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
        if self
            .array
            .size()
            .is_some_and(|size| size != (width, height))
        {
            return Err(SaveError::SizeChanged {
                image: image.to_owned(),
                width,
                height,
            });
        }
        self.array.push(disparity_fraction)?;
        self.ids.push_str(image);
        self.ids.push('\n');
        Ok(())
    }

    /// Completes the array and writes ids (`NAME.ids.txt`) and description (`NAME.yaml`) beside it.
    ///
    /// # Errors
    /// The files cannot be written.
    pub fn finish(self) -> Result<(), SaveError> {
        let Self { path, array, ids } = self;
        array.finish()?;
        files::write_atomic(&path.with_extension("ids.txt"), ids.as_bytes())?;
        let description = SavedDescription::plain(OutputMeaning::DisparityFraction);
        let text = strat_store::yaml::to_string(&description)?;
        files::write_atomic(&path.with_extension("yaml"), text.as_bytes())?;
        Ok(())
    }
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
        let bytes = std::fs::read(&path).unwrap();
        let (header, values) = bytes.split_at(bytes.len() - 12 * 4);
        let header = String::from_utf8_lossy(header);
        assert!(header.contains("'shape': (2, 2, 3)"), "{header}");
        assert_eq!(values[11 * 4..], 15.0_f32.to_le_bytes());
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
