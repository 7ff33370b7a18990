//! The two questions that can only be asked of shared libraries directly: which ONNX Runtime is
//! in a file, and is there an NVIDIA driver with a device.
//!
//! Everything here is a call of a C function whose signature is fixed by a public header
//! (`onnxruntime_c_api.h`, `cuda.h`). Nothing else in `bench` is unsafe. Loading a library runs
//! its initialisers, so only files that are about to be used anyway are opened.
#![allow(
    unsafe_code,
    reason = "asking a shared library a question needs dlopen and C calls; each has its own note"
)]

use std::{
    ffi::{CStr, c_char, c_int},
    path::Path,
};

use ort::AsPointer;

/// The CUDA release that the ONNX Runtime of `bench setup --gpu` is built for, as the driver
/// counts: 1000 x major + 10 x minor.
const CUDA_NEEDED: i32 = 13_000;

/// The version of the ONNX Runtime in `path` (a file, or a name the system's loader knows).
///
/// # Errors
/// The loader's reason, or that the file is another library.
pub(crate) fn onnxruntime_version(path: &Path) -> Result<String, String> {
    // SAFETY: opening a shared library runs its initialisers; the callers pass only ONNX Runtime
    // candidates, which ort would open in the same way a moment later.
    let library = unsafe { libloading::Library::new(path) }.map_err(|error| {
        // The loader's own words are the cause, not the message.
        let cause = std::error::Error::source(&error).map(ToString::to_string);
        cause.unwrap_or_else(|| error.to_string())
    })?;
    // SAFETY: the symbol's type is fixed by onnxruntime_c_api.h and has not changed since its
    // first release; the pointers are checked before use. The version text is static inside the
    // library, which stays open until the text has been copied.
    let version = unsafe {
        let base: libloading::Symbol<'_, unsafe extern "C" fn() -> *const ort::sys::OrtApiBase> =
            library
                .get(b"OrtGetApiBase")
                .map_err(|_| format!("{} is not ONNX Runtime", path.display()))?;
        let base = base();
        if base.is_null() {
            return Err(format!("{} gave no interface", path.display()));
        }
        let version = ((*base).GetVersionString)();
        if version.is_null() {
            return Err(format!("{} gave no version", path.display()));
        }
        CStr::from_ptr(version).to_string_lossy().into_owned()
    };
    // It is about to be used; closing a large C++ library and opening it again gains nothing.
    std::mem::forget(library);
    Ok(version)
}

/// The execution providers that the nodes of a loaded graph were given to, with node counts,
/// sorted by name. Empty when the library does not tell.
///
/// This is the only truthful source: a registered provider may still have got no node at all.
pub(crate) fn providers_of(session: &ort::session::Session) -> Vec<(String, usize)> {
    let mut subgraphs = std::ptr::null();
    let mut count = 0;
    let mut found = std::collections::BTreeMap::<String, usize>::new();
    // SAFETY: the session pointer is valid while `session` is borrowed; the out-pointers are
    // ours. On success the library lends arrays that live as long as the session, with `count`
    // valid entries; a failure status is freed by `result_from_status`.
    unsafe {
        let api = ort::api();
        let status = (api.Session_GetEpGraphAssignmentInfo)(
            session.ptr(),
            &raw mut subgraphs,
            &raw mut count,
        );
        if ort::Error::result_from_status(status).is_err() || subgraphs.is_null() {
            return Vec::new();
        }
        for index in 0..count {
            let subgraph = *subgraphs.add(index);
            let mut name: *const c_char = std::ptr::null();
            let mut nodes = std::ptr::null();
            let mut node_count = 0;
            let named = (api.EpAssignedSubgraph_GetEpName)(subgraph, &raw mut name);
            if ort::Error::result_from_status(named).is_err() || name.is_null() {
                continue;
            }
            let listed =
                (api.EpAssignedSubgraph_GetNodes)(subgraph, &raw mut nodes, &raw mut node_count);
            if ort::Error::result_from_status(listed).is_err() {
                node_count = 0;
            }
            *found
                .entry(CStr::from_ptr(name).to_string_lossy().into_owned())
                .or_default() += node_count;
        }
    }
    found.into_iter().collect()
}

/// What the NVIDIA driver says about itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct CudaDriver {
    /// CUDA release the driver supports, 1000 x major + 10 x minor.
    pub version: i32,
    /// Usable devices.
    pub devices: i32,
}

/// Why CUDA cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CudaUnavailable {
    /// `libcuda` is not there.
    #[error(
        "this machine has no NVIDIA driver ({library} could not be opened); \
         leave out `--device` to run on the CPU"
    )]
    NoDriver {
        /// File name of the driver library on this platform.
        library: String,
    },
    /// The driver library is there but does not start.
    #[error(
        "the NVIDIA driver is installed but does not start (cuInit answered {code}); \
         `nvidia-smi` should say why"
    )]
    NotStarted {
        /// The driver's result code (`CUresult`).
        code: i32,
    },
    /// The driver is older than the runtime's CUDA.
    #[error(
        "the NVIDIA driver supports CUDA {}.{}, but ONNX Runtime needs CUDA {}.{}; \
         update the driver, or leave out `--device`",
        version / 1000, version % 1000 / 10, CUDA_NEEDED / 1000, CUDA_NEEDED % 1000 / 10
    )]
    DriverTooOld {
        /// CUDA release the driver supports, 1000 x major + 10 x minor.
        version: i32,
    },
    /// A driver without a device, as in a container that was not given one.
    #[error(
        "the NVIDIA driver is there, but no device is visible; check CUDA_VISIBLE_DEVICES and \
         whether this container was given a GPU"
    )]
    NoDevice,
    /// A device beyond the last one.
    #[error(
        "NVIDIA device {index} does not exist: the driver shows {devices}, counted from 0; \
         CUDA_VISIBLE_DEVICES may hide others"
    )]
    NoSuchDevice {
        /// The number asked for.
        index: u8,
        /// Devices there are.
        devices: i32,
    },
}

impl CudaDriver {
    /// # Errors
    /// There are not as many devices.
    pub(crate) fn has(self, index: u8) -> Result<(), CudaUnavailable> {
        if i32::from(index) < self.devices {
            Ok(())
        } else {
            Err(CudaUnavailable::NoSuchDevice {
                index,
                devices: self.devices,
            })
        }
    }
}

/// File name of the TensorRT library that ONNX Runtime's provider opens.
pub(crate) const TENSORRT: &str = if cfg!(windows) {
    "nvinfer_10.dll"
} else {
    "libnvinfer.so.10"
};

/// Whether the system's loader finds and opens a library.
pub(crate) fn opens(name: &str) -> bool {
    // SAFETY: opening runs the library's initialisers; the one caller passes TensorRT, which ONNX
    // Runtime would open in the same way a moment later.
    let Ok(library) = (unsafe { libloading::Library::new(name) }) else {
        return false;
    };
    // It is about to be used.
    std::mem::forget(library);
    true
}

/// Asks the NVIDIA driver whether CUDA can work at all, before ONNX Runtime fails obscurely.
///
/// # Errors
/// The first thing that is missing, as a sentence.
pub(crate) fn cuda_driver() -> Result<CudaDriver, CudaUnavailable> {
    let name = if cfg!(windows) {
        "nvcuda.dll"
    } else {
        "libcuda.so.1"
    };
    let missing = || CudaUnavailable::NoDriver {
        library: name.to_owned(),
    };
    // SAFETY: the driver's own library, which every CUDA program opens first.
    let library = unsafe { libloading::Library::new(name) }.map_err(|_| missing())?;
    // SAFETY: signatures of cuda.h: cuInit(unsigned flags), cuDriverGetVersion(int*),
    // cuDeviceGetCount(int*), each returning a CUresult. The pointers are to local integers.
    let (started, version, counted, devices) = unsafe {
        let init: libloading::Symbol<'_, unsafe extern "C" fn(u32) -> c_int> =
            library.get(b"cuInit").map_err(|_| missing())?;
        let get_version: libloading::Symbol<'_, unsafe extern "C" fn(*mut c_int) -> c_int> =
            library.get(b"cuDriverGetVersion").map_err(|_| missing())?;
        let get_count: libloading::Symbol<'_, unsafe extern "C" fn(*mut c_int) -> c_int> =
            library.get(b"cuDeviceGetCount").map_err(|_| missing())?;
        let (mut version, mut devices) = (0, 0);
        let started = init(0);
        get_version(&raw mut version);
        let counted = if started == 0 {
            get_count(&raw mut devices)
        } else {
            started
        };
        (started, version, counted, devices)
    };
    // The driver stays loaded: ONNX Runtime is about to use it, and unloading it is not safe.
    std::mem::forget(library);
    judge_driver(started, counted, CudaDriver { version, devices })
}

/// Turns the driver's answers into a verdict.
fn judge_driver(
    started: i32,
    counted: i32,
    driver: CudaDriver,
) -> Result<CudaDriver, CudaUnavailable> {
    /// `CUDA_ERROR_NO_DEVICE` of cuda.h.
    const NO_DEVICE: i32 = 100;
    if started == NO_DEVICE || counted == NO_DEVICE {
        return Err(CudaUnavailable::NoDevice);
    }
    if started != 0 {
        return Err(CudaUnavailable::NotStarted { code: started });
    }
    if driver.version < CUDA_NEEDED {
        return Err(CudaUnavailable::DriverTooOld {
            version: driver.version,
        });
    }
    if counted != 0 || driver.devices == 0 {
        return Err(CudaUnavailable::NoDevice);
    }
    Ok(driver)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn driver_verdicts_are_sentences() {
        let driver = |version, devices| CudaDriver { version, devices };
        assert!(judge_driver(0, 0, driver(13_010, 2)).is_ok());
        let old = judge_driver(0, 0, driver(12_080, 1)).unwrap_err();
        assert!(old.to_string().contains("CUDA 12.8, but"), "{old}");
        assert!(old.to_string().contains("needs CUDA 13.0"), "{old}");
        assert_eq!(
            judge_driver(0, 0, driver(13_000, 0)),
            Err(CudaUnavailable::NoDevice)
        );
        assert_eq!(
            judge_driver(100, 100, driver(13_000, 0)),
            Err(CudaUnavailable::NoDevice)
        );
        assert!(driver(13_000, 2).has(1).is_ok());
        let beyond = driver(13_000, 2).has(2).unwrap_err();
        assert!(
            beyond
                .to_string()
                .contains("NVIDIA device 2 does not exist"),
            "{beyond}"
        );
        let dead = judge_driver(999, 999, driver(0, 0)).unwrap_err();
        assert!(dead.to_string().contains("cuInit answered 999"), "{dead}");
    }

    #[test]
    fn a_file_that_is_no_library_is_refused() {
        let file = tempfile::NamedTempFile::new().unwrap();
        assert!(onnxruntime_version(file.path()).is_err());
    }
}
