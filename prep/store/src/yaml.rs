//! YAML files with errors that name the file, the line and the key.

use std::path::Path;

use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::error::{Error, Result};
use crate::files;

/// Reads a YAML file. Whether unknown keys are refused is up to `T`.
///
/// # Errors
/// The file cannot be read or does not fit `T`; the message has key path, line and column.
pub fn load<T: DeserializeOwned>(path: &Path) -> Result<T> {
    let bytes = files::read(path)?;
    serde_yaml::from_slice(&bytes).map_err(|error| Error::Yaml {
        path: path.to_owned(),
        problem: error.to_string(),
    })
}

/// A value as YAML text.
///
/// # Errors
/// The value has a shape that YAML cannot hold.
pub fn to_string<T: Serialize>(value: &T) -> Result<String> {
    serde_yaml::to_string(value).map_err(|error| Error::ToYaml(error.to_string()))
}

#[cfg(test)]
mod tests {
    use serde::Deserialize;

    use super::*;

    #[derive(Debug, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Config {
        epochs: u32,
        loss: Loss,
    }

    #[derive(Debug, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Loss {
        ssim: f64,
    }

    #[test]
    fn values_survive_and_mistakes_are_located() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("config.yaml");
        let config = Config {
            epochs: 50,
            loss: Loss { ssim: 0.1 },
        };
        std::fs::write(&path, to_string(&config).unwrap()).unwrap();
        assert_eq!(load::<Config>(&path).unwrap(), config);

        std::fs::write(&path, "epochs: 50\nloss:\n  ssim: 1.0\n  l2: 3\n").unwrap();
        let error = load::<Config>(&path).unwrap_err().to_string();
        for part in ["config.yaml", "l2", "line 4", "loss"] {
            assert!(error.contains(part), "{part} is missing in: {error}");
        }
        assert!(
            load::<Config>(&folder.path().join("none.yaml"))
                .unwrap_err()
                .is_not_found()
        );
    }
}
