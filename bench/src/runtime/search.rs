//! Where the shared library of ONNX Runtime may be on this machine.
//!
//! Not here: loading it ([`crate::runtime`]) and installing it ([`super::install`]).

use std::path::{Path, PathBuf};

/// The ONNX Runtime release that `bench setup` installs.
pub const ONNXRUNTIME_VERSION: &str = "1.31.1";

/// What the search depends on, read once so that tests can state their own.
#[derive(Clone, Debug, Default)]
pub struct SearchPaths {
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

impl SearchPaths {
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

pub(super) fn package_name(gpu: bool) -> &'static str {
    if gpu {
        "onnxruntime-gpu"
    } else {
        "onnxruntime"
    }
}

pub(super) fn folder_name(gpu: bool) -> String {
    format!("{}-{ONNXRUNTIME_VERSION}", package_name(gpu))
}

/// Where a wheel keeps its shared libraries, given the folder it was unpacked into.
pub(super) fn capi_folder(packages: &Path) -> PathBuf {
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
/// platform in another place. The newest version wins when there are several.
pub(super) fn library_in(folder: &Path) -> Option<PathBuf> {
    let stem = format!("{}onnxruntime", std::env::consts::DLL_PREFIX);
    std::fs::read_dir(folder)
        .ok()?
        .filter_map(Result::ok)
        .filter_map(|entry| {
            let name = entry.file_name();
            let text = name.to_string_lossy();
            let rest = text.strip_prefix(&stem)?;
            // `libonnxruntime_providers_shared.so` is another library.
            let is_library = rest.starts_with('.')
                && format!("{rest}.").contains(&format!("{}.", std::env::consts::DLL_SUFFIX));
            let version = is_library.then(|| version_in(rest))?;
            Some((version, entry.file_name()))
        })
        .max()
        .map(|(_, name)| folder.join(name))
}

/// The numbers of a file name such as `.so.1.31.1`, to be compared as numbers: 1.31 is newer than
/// 1.9.
fn version_in(name: &str) -> Vec<u64> {
    name.split('.')
        .filter_map(|part| part.parse().ok())
        .collect()
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
        let paths = SearchPaths {
            library: Some(PathBuf::from("/somewhere/libonnxruntime.so")),
            strat_home: Some(root.path().to_path_buf()),
            ..SearchPaths::default()
        };
        let found = paths.candidates(false);
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
        let paths = SearchPaths {
            strat_home: Some(root.path().to_path_buf()),
            environments: vec![environment],
            executable_folder: Some(exe),
            ..SearchPaths::default()
        };
        let origins: Vec<&str> = paths
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
        let first = |gpu| paths.candidates(gpu)[0].path.display().to_string();
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
        let mut paths = SearchPaths {
            home: Some(PathBuf::from("/home/u")),
            ..SearchPaths::default()
        };
        assert_eq!(
            paths.install_root(),
            Some(PathBuf::from("/home/u/.local/share/strat"))
        );
        paths.data_home = Some(PathBuf::from("/data"));
        assert_eq!(paths.install_root(), Some(PathBuf::from("/data/strat")));
        paths.strat_home = Some(PathBuf::from("/s"));
        assert_eq!(paths.install_root(), Some(PathBuf::from("/s")));
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn versions_are_numbers_and_not_texts() {
        let root = tempfile::tempdir().unwrap();
        touch(&root.path().join("libonnxruntime.so"));
        touch(&root.path().join("libonnxruntime.so.1.9.0"));
        touch(&root.path().join("libonnxruntime.so.1.31.1"));
        assert_eq!(
            library_in(root.path()),
            Some(root.path().join("libonnxruntime.so.1.31.1"))
        );
    }
}
