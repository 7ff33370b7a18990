//! Finds the ONNX Runtime shared library on this machine and, when asked to, puts it there.
//!
//! The library is the one inside the `onnxruntime` (or `onnxruntime-gpu`) wheel of the Python
//! package registry: it exists for every platform, needs no compiler and is loaded at run time.
//! `bench setup` lets `pip` unpack that wheel into a folder of its own; no Python package is
//! installed into any environment, and Python is not used again afterwards.
//!
//! What this module does not do: load the library ([`crate::runtime`] does), and fetch anything
//! unless [`install`] or [`ensure_runtime`] is called.

use std::{
    ffi::OsString,
    path::{Path, PathBuf},
    process::{Command, Stdio},
    sync::{Mutex, OnceLock, PoisonError},
};

/// The ONNX Runtime release that `bench setup` installs.
pub const ONNXRUNTIME_VERSION: &str = "1.31.1";

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
        "there is no folder to install into: neither STRAT_HOME nor a home folder is set; \
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
    #[error("{what} {}: {source}", path.display())]
    Folder {
        /// What was attempted, as the beginning of a sentence.
        what: &'static str,
        /// The folder.
        path: PathBuf,
        /// The system's answer.
        source: std::io::Error,
    },
}

/// The surroundings the search depends on, read once so that tests can state their own.
#[derive(Clone, Debug, Default)]
pub struct Surroundings {
    /// `ORT_DYLIB_PATH`: this library and no other.
    pub library: Option<PathBuf>,
    /// `STRAT_HOME`: the folder for everything `bench setup` installs.
    pub strat_home: Option<PathBuf>,
    /// `XDG_DATA_HOME` (`LOCALAPPDATA` on Windows).
    pub data_home: Option<PathBuf>,
    /// The user's home folder.
    pub home: Option<PathBuf>,
    /// Roots of active Python environments (`VIRTUAL_ENV`, `CONDA_PREFIX`).
    pub environments: Vec<PathBuf>,
    /// The folder of the running executable.
    pub executable_folder: Option<PathBuf>,
}

impl Surroundings {
    /// Reads the process environment; empty variables count as unset.
    #[must_use]
    pub fn of_this_process() -> Self {
        let path = |name: &str| {
            std::env::var_os(name)
                .filter(|value| !value.is_empty())
                .map(PathBuf::from)
        };
        Self {
            library: path("ORT_DYLIB_PATH"),
            strat_home: path("STRAT_HOME"),
            data_home: path(if cfg!(windows) {
                "LOCALAPPDATA"
            } else {
                "XDG_DATA_HOME"
            }),
            home: std::env::home_dir().filter(|home| !home.as_os_str().is_empty()),
            environments: ["VIRTUAL_ENV", "CONDA_PREFIX"]
                .into_iter()
                .filter_map(path)
                .collect(),
            executable_folder: std::env::current_exe()
                .ok()
                .and_then(|exe| exe.parent().map(Path::to_path_buf)),
        }
    }

    /// The folder that holds installed runtimes: `STRAT_HOME`, else the user's data folder.
    #[must_use]
    pub fn install_root(&self) -> Option<PathBuf> {
        self.strat_home.clone().or_else(|| {
            self.data_home
                .clone()
                .or_else(|| self.home.as_ref().map(|home| home.join(".local/share")))
                .map(|data| data.join("strat"))
        })
    }

    /// Places where the library may be, best first (ORT_DYLIB_PATH excludes all others).
    ///
    /// `prefer_gpu` puts the folder of `bench setup --gpu` before the plain one.
    #[must_use]
    pub fn candidates(&self, prefer_gpu: bool) -> Vec<Candidate> {
        if let Some(named) = &self.library {
            // A relative path means "beside the executable" to programs that bundle the
            // library; a path that exists from here is what a user at a prompt means.
            let beside = self
                .executable_folder
                .as_ref()
                .map(|folder| folder.join(named))
                .filter(|path| named.is_relative() && path.exists());
            return vec![Candidate {
                path: beside.unwrap_or_else(|| named.clone()),
                origin: "ORT_DYLIB_PATH",
            }];
        }
        let mut found = Vec::new();
        let mut offer = |folder: &Path, origin: &'static str| {
            if let Some(path) = library_in(folder) {
                found.push(Candidate { path, origin });
            }
        };
        if let Some(root) = self.install_root() {
            for gpu in [prefer_gpu, !prefer_gpu] {
                offer(&capi_folder(&root.join(folder_name(gpu))), "bench setup");
            }
        }
        if let Some(folder) = &self.executable_folder {
            offer(folder, "the executable's folder");
        }
        for environment in &self.environments {
            for packages in site_packages(environment) {
                offer(&capi_folder(&packages), "the Python environment");
            }
        }
        found.push(Candidate {
            path: PathBuf::from(library_file_name()),
            origin: "the system's library path",
        });
        found
    }
}

/// A place where the library may be.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Candidate {
    /// A file, or a bare name for the system's loader to find.
    pub path: PathBuf,
    /// Whose suggestion this is, for messages.
    pub origin: &'static str,
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
    let surroundings = Surroundings::of_this_process();
    for candidate in surroundings.candidates(false) {
        if crate::runtime::ffi::onnxruntime_version(&candidate.path).is_ok() {
            return Availability::Ready(candidate.path);
        }
        if surroundings.library.is_some() {
            return Availability::Unavailable(format!(
                "ORT_DYLIB_PATH names {}, which is not an ONNX Runtime library",
                candidate.path.display()
            ));
        }
    }
    // Without a network every attempt waits for it; one per process is enough.
    FIRST_ATTEMPT
        .get_or_init(|| match install(&SetupOptions::default(), &surroundings) {
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
    surroundings: &Surroundings,
) -> Result<Option<Installed>, SetupError> {
    let root = options
        .root
        .clone()
        .or_else(|| surroundings.install_root())
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
pub fn install(
    options: &SetupOptions,
    surroundings: &Surroundings,
) -> Result<Installed, SetupError> {
    if let Some(installed) = installed(options, surroundings)? {
        return Ok(installed);
    }
    let root = options
        .root
        .clone()
        .or_else(|| surroundings.install_root())
        .ok_or(SetupError::NoHome)?;
    let folder = root.join(folder_name(options.gpu));
    let at = |what: &'static str, path: &Path| {
        let path = path.to_path_buf();
        move |source| SetupError::Folder { what, path, source }
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

/// Folders of the CUDA libraries that `bench setup --gpu` put beside `library`, when it did.
///
/// Returns the CUDA toolkit's and the cuDNN folder.
#[must_use]
pub fn cuda_folders(library: &Path) -> Option<(PathBuf, PathBuf)> {
    let packages = library.parent()?.parent()?.parent()?;
    let nvidia = packages.join("nvidia");
    let library_folder = if cfg!(windows) { "bin" } else { "lib" };
    let toolkit = nvidia.join("cu13").join(library_folder);
    let cudnn = nvidia.join("cudnn").join(library_folder);
    (toolkit.is_dir() && cudnn.is_dir()).then_some((toolkit, cudnn))
}

/// File name of the library on this platform, without a version.
#[must_use]
pub fn library_file_name() -> String {
    format!(
        "{}onnxruntime{}",
        std::env::consts::DLL_PREFIX,
        std::env::consts::DLL_SUFFIX
    )
}

fn package_name(gpu: bool) -> &'static str {
    if gpu {
        "onnxruntime-gpu"
    } else {
        "onnxruntime"
    }
}

fn folder_name(gpu: bool) -> String {
    format!("{}-{ONNXRUNTIME_VERSION}", package_name(gpu))
}

/// Where a wheel keeps its shared libraries, given the folder it was unpacked into.
fn capi_folder(packages: &Path) -> PathBuf {
    packages.join("onnxruntime").join("capi")
}

/// `lib/pythonX.Y/site-packages` of a Python environment, whatever its Python version.
fn site_packages(environment: &Path) -> Vec<PathBuf> {
    if cfg!(windows) {
        return vec![environment.join("Lib").join("site-packages")];
    }
    let mut found: Vec<PathBuf> = std::fs::read_dir(environment.join("lib"))
        .into_iter()
        .flatten()
        .filter_map(Result::ok)
        .filter(|entry| entry.file_name().to_string_lossy().starts_with("python3"))
        .map(|entry| entry.path().join("site-packages"))
        .collect();
    found.sort();
    found
}

/// The ONNX Runtime library in `folder`: wheels put the version into the file's name, each
/// platform in another place. The newest name wins when there are several.
fn library_in(folder: &Path) -> Option<PathBuf> {
    let stem = format!("{}onnxruntime", std::env::consts::DLL_PREFIX);
    let mut found: Vec<OsString> = std::fs::read_dir(folder)
        .ok()?
        .filter_map(Result::ok)
        .map(|entry| entry.file_name())
        .filter(|name| {
            let name = name.to_string_lossy();
            name.strip_prefix(&stem).is_some_and(|rest| {
                // `libonnxruntime_providers_shared.so` is another library.
                rest.starts_with('.')
                    && format!("{rest}.").contains(&format!("{}.", std::env::consts::DLL_SUFFIX))
            })
        })
        .collect();
    found.sort();
    found.pop().map(|name| folder.join(name))
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
        .map_err(|source| SetupError::Folder {
            what: "could not start python3 for",
            path: target.to_path_buf(),
            source,
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
    fn a_named_library_excludes_all_others() {
        let root = tempfile::tempdir().unwrap();
        let installed = root.path().join(folder_name(false));
        touch(&capi_folder(&installed).join(library_file_name()));
        let surroundings = Surroundings {
            library: Some(PathBuf::from("/somewhere/libonnxruntime.so")),
            strat_home: Some(root.path().to_path_buf()),
            ..Surroundings::default()
        };
        let found = surroundings.candidates(false);
        assert_eq!(found.len(), 1);
        assert_eq!(found[0].origin, "ORT_DYLIB_PATH");
    }

    #[test]
    fn the_search_goes_from_set_up_to_the_system() {
        let root = tempfile::tempdir().unwrap();
        let file = library_file_name();
        let exe = root.path().join("bin");
        let environment = root.path().join("venv");
        touch(&capi_folder(&root.path().join(folder_name(false))).join(&file));
        touch(&capi_folder(&root.path().join(folder_name(true))).join(&file));
        touch(&exe.join(&file));
        let packages = if cfg!(windows) {
            environment.join("Lib").join("site-packages")
        } else {
            environment.join("lib/python3.12/site-packages")
        };
        touch(&capi_folder(&packages).join(&file));
        let surroundings = Surroundings {
            strat_home: Some(root.path().to_path_buf()),
            environments: vec![environment],
            executable_folder: Some(exe),
            ..Surroundings::default()
        };
        let origins: Vec<&str> = surroundings
            .candidates(false)
            .iter()
            .map(|candidate| candidate.origin)
            .collect();
        assert_eq!(
            origins,
            [
                "bench setup",
                "bench setup",
                "the executable's folder",
                "the Python environment",
                "the system's library path"
            ]
        );
        let first = |gpu| surroundings.candidates(gpu)[0].path.display().to_string();
        assert!(first(true).contains("onnxruntime-gpu-"), "{}", first(true));
        assert!(!first(false).contains("onnxruntime-gpu-"));
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn the_library_is_recognised_by_name() {
        let root = tempfile::tempdir().unwrap();
        touch(&root.path().join("libonnxruntime_providers_shared.so"));
        assert_eq!(library_in(root.path()), None);
        touch(&root.path().join("libonnxruntime.so.1.31.1"));
        assert_eq!(
            library_in(root.path()),
            Some(root.path().join("libonnxruntime.so.1.31.1"))
        );
    }

    #[test]
    fn strat_home_comes_before_the_data_folder() {
        let mut surroundings = Surroundings {
            home: Some(PathBuf::from("/home/u")),
            ..Surroundings::default()
        };
        assert_eq!(
            surroundings.install_root(),
            Some(PathBuf::from("/home/u/.local/share/strat"))
        );
        surroundings.data_home = Some(PathBuf::from("/data"));
        assert_eq!(
            surroundings.install_root(),
            Some(PathBuf::from("/data/strat"))
        );
        surroundings.strat_home = Some(PathBuf::from("/s"));
        assert_eq!(surroundings.install_root(), Some(PathBuf::from("/s")));
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
        let installed = install(&options, &Surroundings::default()).unwrap();
        assert!(installed.already_there);
        assert_eq!(installed.library, library);
    }

    #[test]
    fn nowhere_to_install_is_said() {
        let error = install(&SetupOptions::default(), &Surroundings::default()).unwrap_err();
        assert!(error.to_string().contains("bench setup --dir"), "{error}");
    }
}
