//! How the images of a part of a divided run agree with the truth, as a file.
//!
//! What is said of a model is said of all its images and of the first ones. The figures of parts do not
//! become those of the whole, bit for bit, so each part keeps what they are made of.

use std::path::Path;

use serde::{Deserialize, Serialize};
use strat_store::{
    Error, files,
    inputs::{self, Kind},
};

use super::{agreement::ImageAgreement, suspicion::Look};

/// The file in the folder of a part.
pub const AGREEMENTS: &str = "agreements.csv";

/// One image of one model.
#[derive(Clone, Debug, PartialEq)]
pub struct Agreed {
    /// Name of the model.
    pub model: String,
    /// Image id.
    pub image: String,
    /// How its depth lies beside the truth.
    pub agreement: ImageAgreement,
    /// What it shows, where it is one of the first images of its part.
    pub look: Option<Look>,
}

/// As it stands in the file.
#[derive(Serialize, Deserialize)]
struct Line {
    model: String,
    image: String,
    ratio: Option<f64>,
    rank_correlation: Option<f64>,
    mirrored: Option<f64>,
    upside_down: Option<f64>,
    transposed: Option<f64>,
    sky_is_nearest: Option<bool>,
    /// Only where the image was looked at.
    width: Option<f64>,
    focal_px: Option<f64>,
}

impl From<&Agreed> for Line {
    fn from(agreed: &Agreed) -> Self {
        let look = agreed.look.as_ref();
        let [mirrored, upside_down, transposed] = look.map_or([None; 3], |look| look.turned);
        Self {
            model: agreed.model.clone(),
            image: agreed.image.clone(),
            ratio: agreed.agreement.ratio,
            rank_correlation: agreed.agreement.rank_correlation,
            mirrored,
            upside_down,
            transposed,
            sky_is_nearest: look.and_then(|look| look.sky_is_nearest),
            width: look.map(|look| look.width),
            focal_px: look.map(|look| look.focal_px),
        }
    }
}

impl From<Line> for Agreed {
    fn from(line: Line) -> Self {
        let agreement = ImageAgreement {
            ratio: line.ratio,
            rank_correlation: line.rank_correlation,
        };
        let look = line.width.zip(line.focal_px).map(|(width, focal_px)| Look {
            agreement,
            turned: [line.mirrored, line.upside_down, line.transposed],
            sky_is_nearest: line.sky_is_nearest,
            width,
            focal_px,
        });
        Self {
            model: line.model,
            image: line.image,
            agreement,
            look,
        }
    }
}

/// Writes the file of a part.
///
/// # Errors
/// The folder cannot be written to.
pub fn write(folder: &Path, all: &[Agreed]) -> Result<(), Error> {
    files::write_atomic_with(&folder.join(AGREEMENTS), |file| {
        let mut csv = strat_csv::Writer::new(file);
        for agreed in all {
            csv.serialize(Line::from(agreed))
                .map_err(std::io::Error::other)?;
        }
        csv.flush()
    })
}

/// Reads the file of a part; none of its lines where it was written without any.
///
/// # Errors
/// With a sentence: there is no such file, or it is another one.
pub fn read(folder: &Path) -> Result<Vec<Agreed>, String> {
    let path = folder.join(AGREEMENTS);
    let bytes = match inputs::read(&path, Kind::Table) {
        Ok(bytes) => bytes,
        Err(error) if error.is_not_found() => {
            return Err("it is missing; measure the part again".to_owned());
        }
        Err(error) => return Err(error.to_string()),
    };
    let lines = strat_csv::Reader::new(bytes.as_slice()).deserialize::<Line>();
    let lines = lines.map_err(|error| error.to_string())?;
    Ok(lines.into_iter().map(Agreed::from).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_comes_back_to_the_last_bit() {
        let folder = tempfile::tempdir().unwrap();
        let agreement = ImageAgreement {
            ratio: Some(0.1 + 0.2),
            rank_correlation: None,
        };
        let look = Look {
            agreement,
            turned: [Some(-1.0 / 3.0), None, Some(1e-300)],
            sky_is_nearest: Some(false),
            width: 1242.0,
            focal_px: 721.5377,
        };
        let agreed = |image: &str, look| Agreed {
            model: "a, \"b\"".to_owned(),
            image: image.to_owned(),
            agreement,
            look,
        };
        let all = [agreed("x/1", Some(look)), agreed("x/2", None)];
        write(folder.path(), &all).unwrap();
        assert_eq!(read(folder.path()).unwrap(), all);
        write(folder.path(), &[]).unwrap();
        assert_eq!(read(folder.path()).unwrap(), []);
        std::fs::remove_file(folder.path().join(AGREEMENTS)).unwrap();
        assert!(read(folder.path()).unwrap_err().contains("measure"));
    }
}
