//! Puts the shared library of ONNX Runtime on this machine, when asked to.
//!
//! The library is the one inside the `onnxruntime` (or `onnxruntime-gpu`) wheel of the Python
//! package registry: it exists for every platform, needs no compiler and is loaded at run time.
//! `bench setup` lets `pip` unpack that wheel into a folder of its own; no Python package is
//! installed into any environment, and Python is not used again afterwards.
//!
//! What this module does not do: search ([`super::search`]) and load the library, and fetch anything
//! unless [`install`] or [`ensure_runtime`] is called.

use std::{
    path::{Path, PathBuf},
    process::{Command, Stdio},
    sync::{Mutex, OnceLock, PoisonError},
};

use super::{
    ffi,
    search::{
        ONNXRUNTIME_VERSION, SearchPaths, capi_folder, folder_name, library_file_name, library_in,
        package_name,
    },
};

/// CUDA 13 libraries that `onnxruntime-gpu` opens, as pip requirements.
const CUDA_REQUIREMENTS: [&str; 7] = [
    "nvidia-cuda-runtime~=13.0",
    "nvidia-cublas~=13.0",
    "nvidia-curand~=10.0",
    "nvidia-cufft~=12.0",
    "nvidia-cuda-nvrtc~=13.0",
    "nvidia-nvjitlink~=13.0",
    "nvidia-cudnn-cu13~=9.0",
];

/// Why the runtime could not be installed.
#[derive(Debug, thiserror::Error)]
pub enum SetupError {
    /// Neither `STRAT_HOME` nor a home folder is known.
    #[error(
        "no folder to install into: neither STRAT_HOME nor a home folder is set; \
         name one with `bench setup --dir DIR`"
    )]
    NoHome,
    /// No Python interpreter on the search path.
    #[error(
        "python3 was not found on the PATH; it is needed once, to unpack the ONNX Runtime wheel. \
         Install Python 3 with pip, or point ORT_DYLIB_PATH at an existing {library}"
    )]
    NoPython {
        /// File name of the library on this platform.
        library: String,
    },
    /// Python is there, its package installer is not.
    #[error(
        "{python} has no pip; install it (`{python} -m ensurepip`, or the package python3-pip), \
         or point ORT_DYLIB_PATH at an existing ONNX Runtime library"
    )]
    NoPip {
        /// The interpreter that was asked.
        python: String,
    },
    /// The package registry could not be reached, or has no such wheel: pip cannot tell the two
    /// apart.
    #[error(
        "the Python package registry could not be reached or does not offer {package} for this \
         platform. Check the network and pip's proxy and index settings and run the command again, \
         or point ORT_DYLIB_PATH at an existing ONNX Runtime library (pip said: {detail})"
    )]
    NoNetwork {
        /// What was asked for.
        package: String,
        /// The last line of pip's own message.
        detail: String,
    },
    /// pip ran and failed for another reason.
    #[error("pip could not install {package} into {}: {detail}", folder.display())]
    Pip {
        /// What was asked for.
        package: String,
        /// Where it was to go.
        folder: PathBuf,
        /// The last line of pip's own message.
        detail: String,
    },
    /// pip succeeded but the wheel holds no library of the expected name.
    #[error(
        "{package} was unpacked into {}, but no {library} is inside; \
         there may be no wheel for this platform",
        folder.display()
    )]
    NoLibrary {
        /// What was unpacked.
        package: String,
        /// File name of the library on this platform.
        library: String,
        /// Where it was unpacked.
        folder: PathBuf,
    },
    /// A folder could not be made, renamed or read.
    #[error("{what} {}: {reason}", path.display())]
    Folder {
        /// What was attempted, as the beginning of a sentence.
        what: &'static str,
        /// The folder.
        path: PathBuf,
        /// The system's answer.
        reason: std::io::Error,
    },
}

/// What to install and where.
#[derive(Clone, Debug, Default)]
pub struct SetupOptions {
    /// The CUDA build and the CUDA 13 libraries (about 2.5 GB) instead of the CPU build (70 MB).
    pub gpu: bool,
    /// Replaces `STRAT_HOME` and the user's data folder.
    pub root: Option<PathBuf>,
}

/// The outcome of [`install`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Installed {
    /// The shared library.
    pub library: PathBuf,
    /// The folder that was made; deleting it undoes the set-up.
    pub folder: PathBuf,
    /// It was there before, nothing was fetched.
    pub already_there: bool,
}

/// Whether ONNX Runtime can be used on this machine; see [`ensure_runtime`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Availability {
    /// The library, found or freshly installed.
    Ready(PathBuf),
    /// A sentence saying why it cannot be had.
    Unavailable(String),
}

/// Finds ONNX Runtime and installs it when it is missing.
///
/// For the demo and for tests, which must work on a fresh machine; `bench` itself never fetches
/// anything behind the user's back. Any number of threads and processes may call this at once.
#[must_use]
pub fn ensure_runtime() -> Availability {
    static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());
    static FIRST_ATTEMPT: OnceLock<Availability> = OnceLock::new();
    let _guard = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
    let paths = SearchPaths::of_this_process();
    for candidate in paths.candidates(false) {
        if ffi::onnxruntime_version(&candidate.path).is_ok() {
            return Availability::Ready(candidate.path);
        }
        if paths.library.is_some() {
            return Availability::Unavailable(format!(
                "ORT_DYLIB_PATH names {}, which is not an ONNX Runtime library",
                candidate.path.display()
            ));
        }
    }
    // Without a network every attempt waits for it; one per process is enough.
    FIRST_ATTEMPT
        .get_or_init(|| match install(&SetupOptions::default(), &paths) {
            Ok(installed) => Availability::Ready(installed.library),
            Err(error) => Availability::Unavailable(error.to_string()),
        })
        .clone()
}

/// What [`install`] would find already in place.
///
/// # Errors
/// There is no folder to install into.
pub fn installed(
    options: &SetupOptions,
    paths: &SearchPaths,
) -> Result<Option<Installed>, SetupError> {
    let root = options
        .root
        .clone()
        .or_else(|| paths.install_root())
        .ok_or(SetupError::NoHome)?;
    let folder = root.join(folder_name(options.gpu));
    Ok(library_in(&capi_folder(&folder)).map(|library| Installed {
        library,
        folder,
        already_there: true,
    }))
}

/// Installs ONNX Runtime into its own folder under the install root.
///
/// The wheel is unpacked beside the final folder and renamed into place, so that a killed run
/// leaves nothing that looks installed, and two runs at once both succeed.
///
/// # Errors
/// No folder to install into, no Python, no pip, no network, or no wheel for this platform.
pub fn install(options: &SetupOptions, paths: &SearchPaths) -> Result<Installed, SetupError> {
    if let Some(installed) = installed(options, paths)? {
        return Ok(installed);
    }
    let root = options
        .root
        .clone()
        .or_else(|| paths.install_root())
        .ok_or(SetupError::NoHome)?;
    let folder = root.join(folder_name(options.gpu));
    let at = |what: &'static str, path: &Path| {
        let path = path.to_path_buf();
        move |reason| SetupError::Folder { what, path, reason }
    };
    std::fs::create_dir_all(&root).map_err(at("could not make the folder", &root))?;
    let unpacked = tempfile::Builder::new()
        .prefix(".onnxruntime-unpacking-")
        .tempdir_in(&root)
        .map_err(at("could not make a folder in", &root))?;

    let mut requirements = vec![format!(
        "{}=={ONNXRUNTIME_VERSION}",
        package_name(options.gpu)
    )];
    if options.gpu {
        requirements.extend(CUDA_REQUIREMENTS.map(String::from));
    }
    pip_install(&requirements, unpacked.path())?;
    if library_in(&capi_folder(unpacked.path())).is_none() {
        return Err(SetupError::NoLibrary {
            package: requirements.swap_remove(0),
            library: library_file_name(),
            folder: unpacked.path().to_path_buf(),
        });
    }

    // A folder of that name without a library is a leftover of somebody else; it is moved over
    // only when empty, which is all that rename allows.
    match std::fs::rename(unpacked.path(), &folder) {
        Ok(()) => {
            // The temporary folder has moved; there is nothing left for its guard to delete.
            let _ = unpacked.keep();
        }
        Err(source) => {
            // Another process was faster, which is just as well.
            if library_in(&capi_folder(&folder)).is_none() {
                return Err(at("could not move the unpacked runtime to", &folder)(
                    source,
                ));
            }
        }
    }
    let library = library_in(&capi_folder(&folder)).ok_or_else(|| SetupError::NoLibrary {
        package: requirements.swap_remove(0),
        library: library_file_name(),
        folder: folder.clone(),
    })?;
    Ok(Installed {
        library,
        folder,
        already_there: false,
    })
}

/// Unpacks wheels into `target` without touching any Python environment.
fn pip_install(requirements: &[String], target: &Path) -> Result<(), SetupError> {
    let package = requirements.first().cloned().unwrap_or_default();
    let mut python = None;
    for name in ["python3", "python"] {
        let answer = Command::new(name)
            .args(["-c", "import sys; sys.exit(sys.version_info[0] != 3)"])
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .status();
        if answer.is_ok_and(|status| status.success()) {
            python = Some(name);
            break;
        }
    }
    let Some(python) = python else {
        return Err(SetupError::NoPython {
            library: library_file_name(),
        });
    };
    let output = Command::new(python)
        .args(["-m", "pip", "install", "-q", "--no-deps", "--no-compile"])
        // A fixed Python version makes the choice of wheel independent of the host's Python:
        // only the shared library inside is used.
        .args(["--only-binary=:all:", "--python-version", "3.12"])
        .args([
            "--disable-pip-version-check",
            "--no-input",
            "--retries",
            "2",
        ])
        .arg("--target")
        .arg(target)
        .args(requirements)
        .stdin(Stdio::null())
        .output()
        .map_err(|reason| SetupError::Folder {
            what: "could not start python3 for",
            path: target.to_path_buf(),
            reason,
        })?;
    if output.status.success() {
        return Ok(());
    }
    let talk = String::from_utf8_lossy(&output.stderr);
    if talk.contains("No module named pip") {
        return Err(SetupError::NoPip {
            python: python.to_owned(),
        });
    }
    let detail = talk
        .lines()
        .map(str::trim)
        .rfind(|line| line.starts_with("ERROR"))
        .or_else(|| talk.lines().map(str::trim).rfind(|line| !line.is_empty()))
        .unwrap_or("it gave no reason")
        .to_owned();
    let unreachable = [
        "Retrying (",
        "(from versions: none)",
        "Max retries exceeded",
        "NewConnectionError",
        "ProxyError",
        "Temporary failure in name resolution",
        "Network is unreachable",
        "timed out",
    ];
    if unreachable.iter().any(|sign| talk.contains(sign)) {
        return Err(SetupError::NoNetwork { package, detail });
    }
    Err(SetupError::Pip {
        package,
        folder: target.to_path_buf(),
        detail,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn touch(path: &Path) {
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, b"").unwrap();
    }

    #[test]
    fn an_installed_runtime_is_not_fetched_again() {
        let root = tempfile::tempdir().unwrap();
        let library = capi_folder(&root.path().join(folder_name(false))).join(library_file_name());
        touch(&library);
        let options = SetupOptions {
            gpu: false,
            root: Some(root.path().to_path_buf()),
        };
        let installed = install(&options, &SearchPaths::default()).unwrap();
        assert!(installed.already_there);
        assert_eq!(installed.library, library);
    }

    #[test]
    fn nowhere_to_install_is_said() {
        let error = install(&SetupOptions::default(), &SearchPaths::default()).unwrap_err();
        assert!(error.to_string().contains("bench setup --dir"), "{error}");
    }
}
