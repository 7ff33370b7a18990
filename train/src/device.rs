//! Where the networks run: `--device cpu|wgpu|cuda`.
//!
//! The CPU backend (burn's pure-Rust `flex`) is always there; the GPU backends are cargo
//! features. The default device of burn is never used: it depends on which features
//! some crate of the build turned on.

use std::str::FromStr;
use std::{fmt, panic};

use burn::tensor::Device;

use crate::error::{Error, Result};

/// A backend and, for GPUs, which one of several.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DeviceChoice {
    /// The processor.
    Cpu,
    /// A GPU through Vulkan, Metal or DirectX 12; `None` = the best one.
    Wgpu(Option<usize>),
    /// An NVIDIA GPU through CUDA, by index.
    Cuda(usize),
    /// The processor with one gradient spoilt on purpose, for tests and whoever wants to see it refused
    /// (see [`crate::training::check`]).
    Faulty,
}

impl fmt::Display for DeviceChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Cpu => f.write_str("cpu"),
            Self::Wgpu(None) => f.write_str("wgpu"),
            Self::Wgpu(Some(index)) => write!(f, "wgpu:{index}"),
            Self::Cuda(0) => f.write_str("cuda"),
            Self::Cuda(index) => write!(f, "cuda:{index}"),
            Self::Faulty => f.write_str("faulty"),
        }
    }
}

impl FromStr for DeviceChoice {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let (name, index) = match text.split_once(':') {
            None => (text, None),
            Some((name, index)) => {
                let index = index.parse().map_err(|_| {
                    Error::Device(format!(
                        "`{index}` in the device `{text}` is not a number; write e.g. cuda:1"
                    ))
                })?;
                (name, Some(index))
            }
        };
        match (name, index) {
            ("cpu", None) => Ok(Self::Cpu),
            ("cpu", Some(_)) => Err(Error::Device(
                "the cpu device has no index; write --device cpu".to_owned(),
            )),
            ("faulty", None) => Ok(Self::Faulty),
            ("wgpu", index) => Ok(Self::Wgpu(index)),
            ("cuda", index) => Ok(Self::Cuda(index.unwrap_or(0))),
            _ => Err(Error::Device(format!(
                "unknown device `{text}`; choose cpu, wgpu or cuda"
            ))),
        }
    }
}

/// A line of `train devices`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Listed {
    /// What to write after `--device`.
    pub name: String,
    /// What it is, or why it cannot be used.
    pub note: String,
    /// Whether it can be used.
    pub usable: bool,
}

impl DeviceChoice {
    /// Whether the processor computes.
    #[must_use]
    pub fn is_processor(self) -> bool {
        matches!(self, Self::Cpu | Self::Faulty)
    }

    /// Opens the device, without gradients; `.autodiff()` turns them on.
    ///
    /// # Errors
    /// When the backend is not built in, or nothing answers on it.
    pub fn open(self) -> Result<Device> {
        match self {
            Self::Cpu | Self::Faulty => Ok(Device::flex()),
            Self::Wgpu(index) => open_wgpu(index),
            Self::Cuda(index) => open_cuda(index),
        }
    }
}

/// All backends, usable or not.
#[must_use]
pub fn list() -> Vec<Listed> {
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let mut lines = vec![Listed {
        name: "cpu".to_owned(),
        note: format!("{threads} threads, always there"),
        usable: true,
    }];
    for choice in [DeviceChoice::Wgpu(None), DeviceChoice::Cuda(0)] {
        let (usable, note) = match choice.open() {
            Ok(_) => (true, "there".to_owned()),
            Err(error) => (false, error.to_string()),
        };
        lines.push(Listed {
            name: choice.to_string(),
            note,
            usable,
        });
    }
    lines
}

/// Runs work on a device whose backend ends what it cannot do with a panic; its sentence then.
///
/// # Errors
/// With what the panic said.
pub(crate) fn guarded<T>(work: impl FnOnce() -> T) -> std::result::Result<T, String> {
    let hook = panic::take_hook();
    panic::set_hook(Box::new(|_| {}));
    let done = panic::catch_unwind(panic::AssertUnwindSafe(work));
    panic::set_hook(hook);
    done.map_err(|payload| {
        let text = payload.downcast_ref::<String>().map(String::as_str);
        let text = text.or_else(|| payload.downcast_ref::<&str>().copied());
        text.unwrap_or("it gave no reason").trim().to_owned()
    })
}

/// Whether a small computation gives its result on the device.
///
/// A missing driver shows itself only when the first kernel runs, and then as a panic.
#[cfg(any(feature = "wgpu", feature = "cuda"))]
fn answers(make: impl FnOnce() -> Device) -> Option<Device> {
    let answered = guarded(|| {
        let device = make();
        let sum: f32 = burn::tensor::Tensor::<1>::ones([4], &device)
            .sum()
            .into_scalar();
        (sum == 4.0).then_some(device)
    });
    answered.ok().flatten()
}

#[cfg(feature = "wgpu")]
fn open_wgpu(index: Option<usize>) -> Result<Device> {
    use burn::tensor::DeviceKind;
    let kind = index.map_or(DeviceKind::DefaultDevice, DeviceKind::DiscreteGpu);
    answers(|| Device::wgpu(kind)).ok_or_else(|| {
        Error::Device(
            "no GPU answers through wgpu; it needs a Vulkan, Metal or DirectX 12 driver. \
             Train with --device cpu, or list devices with `train devices`"
                .to_owned(),
        )
    })
}

#[cfg(not(feature = "wgpu"))]
fn open_wgpu(_index: Option<usize>) -> Result<Device> {
    Err(Error::Device(
        "this build has no wgpu backend; build it with \
         `cargo build --release -p strat-train --features wgpu`"
            .to_owned(),
    ))
}

#[cfg(feature = "cuda")]
fn open_cuda(index: usize) -> Result<Device> {
    answers(|| Device::cuda(index)).ok_or_else(|| {
        Error::Device(format!(
            "no CUDA device {index} answers; check `nvidia-smi`. \
             Train with --device cpu, or list devices with `train devices`"
        ))
    })
}

#[cfg(not(feature = "cuda"))]
fn open_cuda(_index: usize) -> Result<Device> {
    Err(Error::Device(
        "this build has no cuda backend; build it with \
         `cargo build --release -p strat-train --features cuda`"
            .to_owned(),
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_read_and_written() {
        for name in ["cpu", "wgpu", "wgpu:1", "cuda", "cuda:2", "faulty"] {
            assert_eq!(name.parse::<DeviceChoice>().unwrap().to_string(), name);
        }
        for (name, part) in [
            ("gpu", "unknown device"),
            ("cuda:x", "not a number"),
            ("cpu:0", "no index"),
        ] {
            let message = name.parse::<DeviceChoice>().unwrap_err().to_string();
            assert!(message.contains(part), "{message}");
        }
    }

    #[test]
    fn the_processor_is_always_listed_first_and_usable() {
        let lines = list();
        assert_eq!(lines.len(), 3);
        assert!(lines[0].usable && lines[0].name == "cpu");
        assert!(DeviceChoice::Cpu.open().is_ok());
    }

    #[test]
    fn what_a_backend_cannot_do_becomes_a_sentence() {
        assert_eq!(guarded(|| 3), Ok(3));
        let stopped: std::result::Result<(), String> = guarded(|| panic!("no kernel {}", 7));
        assert_eq!(stopped, Err("no kernel 7".to_owned()));
    }

    #[cfg(not(feature = "cuda"))]
    #[test]
    fn a_backend_that_is_not_built_in_says_how_to_build_it() {
        let message = DeviceChoice::Cuda(0).open().unwrap_err().to_string();
        assert!(message.contains("--features cuda"), "{message}");
    }
}
