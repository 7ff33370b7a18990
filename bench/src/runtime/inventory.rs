//! What this machine can run models on, and why not on the rest.
//!
//! A device counts as available only after a small graph has been loaded onto it and run: that a
//! library was built for a device says nothing about drivers, and a driver nothing about the
//! library. What is asked, in this order: the NVIDIA driver, the library, the provider inside it,
//! the graph.

use std::{fmt::Write as _, path::PathBuf};

use serde::Serialize;

use super::{Device, Runtime, RuntimeChoice, ffi, search::SearchPaths};

/// The processor, as measurements name it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Processor {
    /// Its name, `unknown` where the system does not tell.
    pub model: String,
    /// Threads that this process may use (respects cgroups and affinity).
    pub threads: usize,
}

/// A library that was looked at.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Library {
    /// The file, or the bare name given to the system's loader.
    pub path: PathBuf,
    /// Whose suggestion it is.
    pub origin: &'static str,
    /// Its version; none when it cannot be used.
    pub version: Option<String>,
    /// Why it cannot be used.
    pub problem: Option<String>,
}

/// One device.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct DeviceReport {
    /// As `--device` takes it.
    pub device: String,
    /// ONNX Runtime's name for the provider.
    pub provider: &'static str,
    /// A graph ran on it.
    pub available: bool,
    /// What ran the graph, or why nothing did.
    pub detail: String,
}

/// The answer of `bench devices`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Report {
    /// Version of this program.
    pub tool_version: &'static str,
    /// The processor.
    pub processor: Processor,
    /// Every place where ONNX Runtime was looked for, best first.
    pub libraries: Vec<Library>,
    /// The library in use.
    pub library_in_use: Option<PathBuf>,
    /// Version of the library in use, with its name.
    pub runtime_in_use: String,
    /// The runtime that needs no library.
    pub embedded: String,
    /// NVIDIA's driver: its CUDA release and the devices it shows, or what is wrong.
    pub nvidia: String,
    /// One entry per kind of device; NVIDIA devices one by one.
    pub devices: Vec<DeviceReport>,
}

/// The processor that this runs on.
#[must_use]
pub fn processor() -> Processor {
    Processor {
        model: processor_name().unwrap_or_else(|| "unknown".to_owned()),
        threads: std::thread::available_parallelism().map_or(1, usize::from),
    }
}

fn processor_name() -> Option<String> {
    let text = if cfg!(target_os = "linux") {
        let text = std::fs::read_to_string("/proc/cpuinfo").ok()?;
        // Arm kernels give no name, only the part's number.
        text.lines()
            .find(|line| line.starts_with("model name") || line.starts_with("CPU part"))?
            .split_once(':')?
            .1
            .to_owned()
    } else if cfg!(target_os = "macos") {
        let output = std::process::Command::new("sysctl")
            .args(["-n", "machdep.cpu.brand_string"])
            .output()
            .ok()?;
        String::from_utf8(output.stdout).ok()?
    } else {
        std::env::var("PROCESSOR_IDENTIFIER").ok()?
    };
    let words: Vec<&str> = text.split_whitespace().collect();
    (!words.is_empty()).then(|| words.join(" "))
}

impl Report {
    /// Looks at everything. Loads ONNX Runtime into the process, the GPU build where both are
    /// installed.
    #[must_use]
    pub fn collect() -> Self {
        let libraries = SearchPaths::of_this_process()
            .candidates(true)
            .into_iter()
            .map(|candidate| {
                let version = ffi::onnxruntime_version(&candidate.path);
                Library {
                    path: candidate.path,
                    origin: candidate.origin,
                    problem: version.as_ref().err().cloned(),
                    version: version.ok(),
                }
            })
            .collect();
        let driver = ffi::cuda_driver();
        let nvidia = match &driver {
            Ok(driver) => format!(
                "driver for CUDA {}.{}, {} device(s)",
                driver.version / 1000,
                driver.version % 1000 / 10,
                driver.devices
            ),
            Err(reason) => reason.to_string(),
        };
        let count = driver.map_or(1, |driver| u8::try_from(driver.devices).unwrap_or(u8::MAX));
        // The first library into the process stays, so the GPU build must be asked for first.
        let devices: Vec<DeviceReport> = [Device::Cuda, Device::TensorRt]
            .into_iter()
            .flat_map(|kind| (0..count).map(kind))
            .chain([Device::CoreMl, Device::DirectMl(0)])
            .map(|device| device_report(device, RuntimeChoice::Ort))
            .collect();
        let processor_report = device_report(Device::Cpu, RuntimeChoice::Auto);
        let (library_in_use, runtime_in_use) =
            match Runtime::resolve(RuntimeChoice::Ort, Device::Cpu) {
                Ok((runtime, _)) => (
                    runtime.library().map(std::path::Path::to_path_buf),
                    runtime.to_string(),
                ),
                Err(_) => (None, "none (remedy: `bench setup`)".to_owned()),
            };
        Self {
            tool_version: env!("CARGO_PKG_VERSION"),
            processor: processor(),
            libraries,
            library_in_use,
            runtime_in_use,
            embedded: "rten, always there, CPU only".to_owned(),
            nvidia,
            devices: std::iter::once(processor_report).chain(devices).collect(),
        }
    }

    /// For people.
    #[must_use]
    pub fn text(&self) -> String {
        let mut text = String::new();
        let mut line = |name: &str, value: &str| {
            // Writing to a text cannot fail.
            let _ = writeln!(text, "{name:<13}{value}");
        };
        let Processor { model, threads } = &self.processor;
        line("processor", &format!("{model}, {threads} threads"));
        line("onnxruntime", &self.runtime_in_use);
        for library in &self.libraries {
            let used = self.library_in_use.as_ref() == Some(&library.path);
            let said = match (&library.version, &library.problem) {
                (Some(version), _) => format!(
                    "{} {} ({})",
                    if used { "in use:" } else { "also there:" },
                    library.path.display(),
                    [version, library.origin].join(", from ")
                ),
                (None, problem) => format!(
                    "not usable: {} ({}): {}",
                    library.path.display(),
                    library.origin,
                    problem.as_deref().unwrap_or("no reason given")
                ),
            };
            line("", &said);
        }
        line("embedded", &self.embedded);
        line("nvidia", &self.nvidia);
        text.push('\n');
        for report in &self.devices {
            let verdict = if report.available {
                "available"
            } else {
                "not available"
            };
            let _ = writeln!(
                text,
                "{:<12} {verdict:<14} {}",
                report.device, report.detail
            );
        }
        text
    }
}

fn device_report(device: Device, choice: RuntimeChoice) -> DeviceReport {
    let tried = Runtime::resolve(choice, device)
        .and_then(|(runtime, _)| Ok(format!("{} with {runtime}", runtime.try_device(device)?)));
    DeviceReport {
        device: device.to_string(),
        provider: device.provider(),
        available: tried.is_ok(),
        detail: tried.unwrap_or_else(|reason| reason.to_string()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_processor_has_a_name_and_threads() {
        let processor = processor();
        assert!(processor.threads >= 1);
        assert!(!processor.model.is_empty());
        assert_eq!(processor.model.trim(), processor.model);
    }

    #[test]
    fn every_kind_of_device_is_reported_with_a_reason() {
        let report = Report::collect();
        for kind in ["cpu", "cuda:0", "tensorrt:0", "coreml", "directml:0"] {
            let device = report.devices.iter().find(|d| d.device == kind);
            let device = device.unwrap_or_else(|| panic!("{kind} is missing"));
            assert!(!device.detail.is_empty());
            assert!(!device.detail.contains(".cc:"), "{}", device.detail);
        }
        // The embedded runtime makes the processor available everywhere.
        assert!(report.devices[0].available, "{}", report.devices[0].detail);
        let text = report.text();
        assert!(
            text.contains("processor") && text.contains("cuda:0"),
            "{text}"
        );
    }
}
