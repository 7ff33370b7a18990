//! The command as it is typed: messages and exit codes.

use assert_cmd::Command;

/// Runs `train` with words split at spaces; exit code, stdout, stderr.
fn train(line: &str) -> (i32, String, String) {
    let output = Command::cargo_bin("train")
        .unwrap()
        .args(line.split_whitespace())
        .output()
        .unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    (
        output.status.code().unwrap(),
        text(output.stdout),
        text(output.stderr),
    )
}

#[test]
fn help_shows_examples_and_version_is_told() {
    let (code, out, _) = train("--help");
    assert_eq!(code, 0);
    assert!(out.contains("Examples:") && out.contains("Exit codes"));
    let (code, out, _) = train("--version");
    assert_eq!(code, 0);
    assert!(out.starts_with("train "));
}

#[test]
fn the_resolved_configuration_is_printed_and_reads_back() {
    let (code, out, _) = train("--config eigen-fixed --preset half --set epochs=7 --print-config");
    assert_eq!(code, 0);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mine.yaml");
    std::fs::write(&path, &out).unwrap();
    let (code, again, _) = train(&format!("--config {} --print-config", path.display()));
    assert_eq!(code, 0);
    assert_eq!(out, again);
    assert!(out.contains("epochs: 7") && out.contains("variant: fixed"));
}

#[test]
fn devices_and_configurations_are_listed_on_stdout() {
    let (code, out, _) = train("devices");
    assert_eq!(code, 0);
    assert!(out.starts_with("cpu"));
    let (code, out, _) = train("configs");
    assert_eq!(code, 0);
    assert_eq!(out.lines().count(), 10);
    assert!(out.contains("kitti-monodepth"));
}

#[test]
fn wrong_usage_is_code_2_with_a_sentence() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path().display();
    for (line, part) in [
        (String::new(), "--config"),
        ("--config nowhere --print-config".into(), "nowhere"),
        ("--config demo --preset huge --print-config".into(), "huge"),
        (
            "--config demo --set epoch=1 --print-config".into(),
            "`epoch`",
        ),
        ("--config demo".into(), "--data"),
        (format!("--config demo --data {here}"), "--out"),
        (
            format!("--config demo --data {here}/none --out {here}/run"),
            "folder not found",
        ),
        (
            format!("--config demo --data {here} --out {here}/run --device gpu"),
            "unknown device",
        ),
        (
            format!("--config demo --data {here} --out {here}/run --device cpu,cpu"),
            "named twice",
        ),
        (
            format!("--config demo --data {here} --out {here}/run --device cuda:0,cuda:1"),
            "accumulate=2",
        ),
        ("estimate".into(), "--config"),
        (
            format!("export {here} --f16 --out {here}/start.safetensors"),
            "--f16",
        ),
        (
            format!("--resume --data {here} --out {here}/run"),
            "nothing can be resumed",
        ),
        ("--nonsense".into(), "--nonsense"),
    ] {
        let (code, out, error) = train(&line);
        assert_eq!(code, 2, "{line}: {error}");
        assert!(error.contains(part), "{line}: {error}");
        assert!(out.is_empty());
    }
}

#[test]
fn an_unknown_key_in_a_file_is_named_with_its_line() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bad.yaml");
    std::fs::write(&path, "split: kitti\nepoch: 3\n").unwrap();
    let (code, _, error) = train(&format!("--config {} --print-config", path.display()));
    assert_eq!(code, 2);
    assert!(
        error.contains("epoch") && error.contains("line 2"),
        "{error}"
    );
}

#[test]
fn folders_that_cannot_be_used_are_code_2_with_a_sentence() {
    let folder = tempfile::tempdir().unwrap();
    let set = folder.path().join("set");
    crate::prepared::write(&set, 0, 0);
    let other = folder.path().join("other");
    std::fs::create_dir(&other).unwrap();
    std::fs::write(other.join("letter.txt"), "dear").unwrap();
    for (line, part) in [
        // A folder that is no set.
        (
            format!(
                "--config kitti-strat --data {0} --out {0}/run",
                other.display()
            ),
            "manifest",
        ),
        // The other split.
        (
            format!(
                "--config eigen-strat --data {} --out {}/run1",
                set.display(),
                folder.path().display()
            ),
            "is of the kitti split",
        ),
        // No training pairs.
        (
            format!(
                "--config kitti-strat --data {} --out {}/run2",
                set.display(),
                folder.path().display()
            ),
            "no train pairs",
        ),
        // A run folder with something else in it.
        (
            format!(
                "--config kitti-strat --data {} --out {}",
                set.display(),
                other.display()
            ),
            "not a training run",
        ),
        (format!("export {}", other.display()), "no training run"),
    ] {
        let (code, out, error) = train(&line);
        assert_eq!(code, 2, "{line}: {error}");
        assert!(error.contains(part), "{line}: {error}");
        assert!(out.is_empty());
    }
    assert!(other.join("letter.txt").exists());
}

#[test]
fn a_short_run_is_trained_resumed_and_exported() {
    let folder = tempfile::tempdir().unwrap();
    let (set, run) = (folder.path().join("set"), folder.path().join("run"));
    crate::prepared::write(&set, 4, 1);
    let places = format!("--data {} --out {}", set.display(), run.display());
    // What cannot fit is refused before anything is written; what can is not.
    let (code, _, error) = train(&format!(
        "--config kitti-strat --preset tiny --set batch=100000000 {places}"
    ));
    assert_eq!(code, 1);
    assert!(
        error.contains("of memory") && error.contains("accumulate="),
        "{error}"
    );
    assert!(!run.join("run.json").exists());
    let (code, out, error) = train(&format!(
        "--config kitti-strat --preset tiny --set network.width=1/32 \
         --set discriminator.width=1/16 --set epochs=2 --max-steps 1 {places}"
    ));
    assert_eq!(code, 0, "{error}");
    assert_eq!(out.trim(), run.join("model.onnx").display().to_string());
    assert!(
        error.contains("training") && error.contains("epoch 1/2"),
        "{error}"
    );
    assert!(error.contains("it is that of step 1 of 2"), "{error}");
    for file in [
        "config.yaml",
        "run.json",
        "scalars.csv",
        "validation.csv",
        "model.onnx",
    ] {
        assert!(run.join(file).is_file(), "{file}");
    }
    let (code, _, error) = train(&format!("--resume --quiet {places}"));
    assert_eq!(code, 0, "{error}");
    assert!(error.is_empty(), "{error}");
    let scalars = std::fs::read_to_string(run.join("scalars.csv")).unwrap();
    assert_eq!(scalars.lines().count(), 3);
    let model = folder.path().join("best.onnx");
    let (code, out, error) = train(&format!(
        "export {} --best --out {}",
        run.display(),
        model.display()
    ));
    assert_eq!(code, 0, "{error}");
    assert_eq!(out.trim(), model.display().to_string());
    assert!(model.is_file());
}

#[test]
fn a_run_killed_between_its_first_files_says_what_helps() {
    let folder = tempfile::tempdir().unwrap();
    let (set, run) = (folder.path().join("set"), folder.path().join("run"));
    crate::prepared::write(&set, 4, 1);
    let line = format!(
        "--config kitti-strat --preset tiny --set network.width=1/32 --set epochs=1 --max-steps 1 \
         --data {} --out {}",
        set.display(),
        run.display()
    );
    // What a run leaves that was killed between the two: its lock and its configuration.
    std::fs::create_dir(&run).unwrap();
    std::fs::write(run.join(".lock"), "").unwrap();
    let (_, config, _) = train(&format!("{line} --print-config"));
    std::fs::write(run.join("config.yaml"), config).unwrap();
    let (code, _, error) = train(&format!("{line} --resume"));
    assert_eq!(code, 2, "{error}");
    assert!(error.contains("again without --resume"), "{error}");
    let (code, _, error) = train(&line);
    assert_eq!(code, 0, "{error}");
}

#[test]
#[cfg(target_os = "linux")]
fn a_full_stderr_and_a_closed_stdout_end_no_run() {
    let folder = tempfile::tempdir().unwrap();
    let (set, run) = (folder.path().join("set"), folder.path().join("run"));
    crate::prepared::write(&set, 4, 1);
    let full = std::fs::OpenOptions::new()
        .write(true)
        .open("/dev/full")
        .unwrap();
    let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_train"));
    command.args([
        "--config",
        "kitti-strat",
        "--preset",
        "tiny",
        "--max-steps",
        "1",
    ]);
    command.args(["--set", "network.width=1/32", "--set", "epochs=1"]);
    command.arg("--data").arg(&set).arg("--out").arg(&run);
    command.stderr(full).stdout(std::process::Stdio::piped());
    let mut child = command.spawn().unwrap();
    drop(child.stdout.take());
    assert_eq!(child.wait().unwrap().code(), Some(0));
    assert!(run.join("model.onnx").is_file());
}

#[test]
fn a_device_that_computes_wrong_gradients_is_found_and_its_layer_named() {
    let (code, out, error) = train("check --device faulty");
    assert_eq!(code, 1, "{error}");
    assert!(out.contains("gradients of the generator"), "{out}");
    let wrong: Vec<&str> = out.lines().filter(|line| line.contains("WRONG")).collect();
    assert_eq!(wrong.len(), 1, "{out}");
    assert!(wrong[0].contains("decoder.iconv3.weight"), "{out}");
    assert!(error.contains("decoder.iconv3.weight"), "{error}");
}

#[test]
fn the_processor_passes_its_own_check_and_tells_what_a_step_takes() {
    let (code, out, error) = train("check --preset tiny --set batch=1");
    assert_eq!(code, 0, "{error}");
    assert!(!out.contains("WRONG"), "{out}");
    assert!(out.contains("a step of batch 1 at 128x64 takes"), "{out}");
}

#[test]
fn a_run_refuses_a_device_with_wrong_gradients_before_it_writes_anything() {
    let folder = tempfile::tempdir().unwrap();
    let (set, out) = (folder.path().join("set"), folder.path().join("run"));
    crate::prepared::write(&set, 2, 0);
    let run = format!(
        "--config kitti-strat --preset tiny --set batch=1 --set network.width=1/32 --max-steps 1 \
         --data {} --out {} --device faulty",
        set.display(),
        out.display()
    );
    let (code, _, error) = train(&run);
    assert_eq!(code, 1, "{error}");
    assert!(error.contains("decoder.iconv3.weight"), "{error}");
    assert!(!out.join("config.yaml").exists());
    let (code, _, error) = train(&format!("{run} --no-check"));
    assert_eq!(code, 0, "{error}");
    let info = std::fs::read_to_string(out.join("run.json")).unwrap();
    assert!(
        info.contains("faulty") && !info.contains("device_checks"),
        "{info}"
    );
}
