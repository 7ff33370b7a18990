//! Folders and files that may not be read or written.

use std::os::unix::fs::PermissionsExt;
use std::os::unix::process::CommandExt;

use strat_needs::Need;
use strat_store::image_files;

use crate::world::{DRIVE_1, DRIVE_2, Outcome, World, assert_has, picture};

/// `prep` as a user to whom permissions apply, which they do not to the superuser; `None` where that
/// cannot be done. The program is copied to where everyone may read it.
fn as_nobody(world: &World, args: &[&str]) -> Option<Outcome> {
    const NOBODY: u32 = 65534;
    let program = world.path("prep");
    if !program.exists() {
        std::fs::copy(env!("CARGO_BIN_EXE_prep"), &program).unwrap();
        std::fs::set_permissions(world.0.path(), PermissionsExt::from_mode(0o777)).unwrap();
    }
    let closed = world.path("closed");
    std::fs::create_dir_all(&closed).unwrap();
    std::fs::set_permissions(&closed, PermissionsExt::from_mode(0o000)).unwrap();
    let mut command = std::process::Command::new(&program);
    command.args(args);
    if std::fs::read_dir(&closed).is_ok() {
        command.gid(NOBODY).uid(NOBODY);
    }
    let output = match command.output() {
        Ok(output) => output,
        Err(error) => {
            let program = program.display();
            Need::OrdinaryUser.is_lacking(format!("cannot run {program} as another user: {error}"));
            return None;
        }
    };
    Some(Outcome {
        code: output.status.code().unwrap(),
        stdout: String::from_utf8(output.stdout).unwrap(),
        stderr: String::from_utf8(output.stderr).unwrap(),
    })
}

#[test]
fn what_may_not_be_read_is_named_and_the_rest_is_made() {
    let world = World::new();
    let allow = |name: &str, mode: u32| {
        std::fs::set_permissions(world.path(name), PermissionsExt::from_mode(mode)).unwrap();
    };
    let run = |out: &str| {
        let (raw, out) = (world.path("raw"), world.path(out));
        let [raw, out] = [&raw, &out].map(|path| path.to_str().unwrap());
        let sizes = [
            "--width",
            "32",
            "--height",
            "16",
            "--allow-missing",
            "--quiet",
        ];
        as_nobody(
            &world,
            &[&["eigen", "--raw", raw, "--out", out], &sizes[..]].concat(),
        )
    };
    let drive = format!("raw/{DRIVE_2}");
    let scans = format!("raw/{DRIVE_2}/velodyne_points/data");
    let image = format!("raw/{DRIVE_1}/image_03/data/0000000004.png");
    for (number, (name, file)) in [(&drive, false), (&scans, false), (&image, true)]
        .into_iter()
        .enumerate()
    {
        allow(name, 0o000);
        let outcome = run(&format!("out-{number}"));
        allow(name, if file { 0o644 } else { 0o755 });
        let Some(outcome) = outcome else { return };
        assert_eq!(outcome.code, 1, "{}", outcome.stderr);
        assert_has(&outcome.stderr, &[name, "Permission denied"]);
        assert_has(&outcome.stdout, &["val 1 of 330"]);
        let failures = world.path(&format!("out-{number}/failures.csv"));
        let failures = std::fs::read_to_string(failures).unwrap();
        assert_has(&failures, &[name, "Permission denied"]);
    }

    allow("raw", 0o000);
    let outcome = run("none").unwrap();
    allow("raw", 0o755);
    assert_eq!(outcome.code, 2, "{}", outcome.stderr);
    assert_has(
        &outcome.stderr,
        &["cannot list the folder", "Permission denied"],
    );
    // Names can be listed, but nothing behind them looked at.
    allow("raw", 0o444);
    let outcome = run("none").unwrap();
    allow("raw", 0o755);
    assert_eq!(outcome.code, 2, "{}", outcome.stderr);
    assert_has(
        &outcome.stderr,
        &["cannot list the folder", "Permission denied"],
    );

    let noc = "stereo/training/disp_noc_0";
    let [raw, stereo, out] = ["raw", "stereo", "scenes"].map(|name| world.path(name));
    let [raw, stereo, out] = [&raw, &stereo, &out].map(|path| path.to_str().unwrap());
    allow(noc, 0o000);
    let args = [
        "kitti",
        "--raw",
        raw,
        "--stereo2015",
        stereo,
        "--out",
        out,
        "--allow-missing",
    ];
    let outcome = as_nobody(&world, &args);
    allow(noc, 0o755);
    let outcome = outcome.unwrap();
    assert_eq!(outcome.code, 1, "{}", outcome.stderr);
    assert_has(&outcome.stderr, &[noc, "Permission denied"]);

    let city = "cityscapes/leftImg8bit/train/aachen";
    let files = [
        (format!("{city}/aachen_000000_000019_leftImg8bit.png"), 40),
        (
            city.replace("aachen", "bochum") + "/bochum_000000_000019_leftImg8bit.png",
            41,
        ),
    ];
    for (name, seed) in &files {
        let png = image_files::encode_png_rgb(&picture(*seed));
        world.write(name, &png);
        world.write(&name.replace("left", "right"), &png);
        let camera = name
            .replace("leftImg8bit.png", "camera.json")
            .replace("leftImg8bit", "camera");
        world.write(
            &camera,
            br#"{"extrinsic": {"baseline": 0.2}, "intrinsic": {"fx": 44.2}}"#,
        );
    }
    allow(city, 0o000);
    let (root, out) = (world.path("cityscapes"), world.path("city-set"));
    let args = ["cityscapes", "--quiet", "--root", root.to_str().unwrap()];
    let outcome = as_nobody(
        &world,
        &[&args[..], &["--out", out.to_str().unwrap()]].concat(),
    );
    allow(city, 0o755);
    let outcome = outcome.unwrap();
    assert_eq!(outcome.code, 1, "{}", outcome.stderr);
    assert_has(&outcome.stderr, &[city, "Permission denied"]);
    assert_has(&outcome.stdout, &["train 1 of 1 pairs"]);

    std::fs::create_dir(world.path("theirs")).unwrap();
    allow("theirs", 0o555);
    let outcome = run("theirs/set").unwrap();
    assert_eq!(outcome.code, 2, "{}", outcome.stderr);
    assert_has(&outcome.stderr, &["theirs/set", "Permission denied"]);
    assert!(!world.path("none").exists());
}
