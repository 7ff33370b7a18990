//! Runs the independent implementation in `tests/oracle`, with numpy from PyPI.
//!
//! numpy is put into the target folder with pip when it is needed for the first time, as ONNX Runtime is;
//! a Python that has it already is left as it is.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

use strat_needs::Need;

use crate::sources::root;

/// What a script of `tests/oracle` prints; `None` where Python or numpy cannot be had.
///
/// # Panics
/// The script fails.
pub fn oracle(script: &str, arguments: &[&Path]) -> Option<String> {
    static PACKAGES: OnceLock<Result<PathBuf, String>> = OnceLock::new();
    let packages = match PACKAGES.get_or_init(packages) {
        Ok(packages) => packages,
        Err(reason) => {
            Need::Numpy.is_lacking(reason);
            return None;
        }
    };
    let script = root().join("tests/oracle").join(script);
    let output = python(packages)
        .arg(&script)
        .args(arguments)
        .output()
        .expect("it ran before");
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{}: {errors}", script.display());
    Some(String::from_utf8(output.stdout).expect("text"))
}

fn python(packages: &Path) -> Command {
    let mut command = Command::new("python3");
    command
        .env("PYTHONPATH", packages)
        .env("PYTHONDONTWRITEBYTECODE", "1");
    command
}

/// The folder with what `requirements.txt` names.
fn packages() -> Result<PathBuf, String> {
    let parent = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let folder = parent.join("oracle-packages");
    let there = || {
        python(&folder)
            .args(["-c", "import numpy, blake3"])
            .output()
    };
    if there()
        .map_err(|e| format!("python3 cannot be started: {e}"))?
        .status
        .success()
    {
        return Ok(folder);
    }
    let unpacked = tempfile::tempdir_in(parent).map_err(|e| e.to_string())?;
    let pip = Command::new("python3")
        .args([
            "-m",
            "pip",
            "install",
            "--quiet",
            "--disable-pip-version-check",
            "--target",
        ])
        .arg(unpacked.path())
        .arg("--requirement")
        .arg(root().join("tests/oracle/requirements.txt"))
        .output()
        .map_err(|e| e.to_string())?;
    if !pip.status.success() {
        return Err(format!(
            "pip: {}",
            String::from_utf8_lossy(&pip.stderr).trim()
        ));
    }
    // Another process may have been faster; its folder is as good.
    let _ = std::fs::rename(unpacked.path(), &folder);
    let usable = there().is_ok_and(|output| output.status.success());
    usable
        .then_some(folder)
        .ok_or_else(|| "python3 cannot import what pip installed".to_owned())
}
