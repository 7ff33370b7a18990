//! The rendered world as a whole: pictures, scans, disparities and labels agree, files
//! can be read by the project's own readers, bytes depend on preset and seed alone.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use strat_geometry::{CamToCam, DepthAxis, VeloToCam, velodyne_depth, velodyne_projection};

use strat_store::command::CliError;
use strat_store::image_files;

use super::noise::Textures;
use super::preset::Purpose;
use super::render::{render_pair, world_of};
use super::scene::Scene;
use super::sensors::lidar::Lidar;
use super::sensors::picture;
use super::sensors::rig::{self, Rig};
use super::sensors::sensor::{Sensor, develop};
use super::sensors::tiles::Tiles;
use super::*;

const DIVISOR: u32 = 3;

static STAGE: LazyLock<Stage> = LazyLock::new(|| Stage {
    textures: Textures::new(),
    shots: preset::shots(Preset::Tiny),
});

struct Stage {
    textures: Textures,
    shots: Vec<Shot>,
}

impl Stage {
    fn rig(shot: &Shot) -> Rig {
        Rig::new(rig::day(shot.date), DIVISOR)
    }
}

/// Share of values for which something holds.
fn share(values: &[f32], holds: impl Fn(f32) -> bool) -> f32 {
    values.iter().filter(|&&v| holds(v)).count() as f32 / values.len() as f32
}

fn median(values: &mut [f32]) -> f32 {
    values.sort_by(f32::total_cmp);
    values[values.len() / 2]
}

#[test]
fn right_picture_moved_by_the_disparity_is_the_left_picture() {
    let stage = &*STAGE;
    for shot in stage.shots.iter().step_by(6) {
        let world = world_of(shot, 1);
        let rig = Stage::rig(shot);
        let pair = render_pair(&world, &stage.textures, rig, shot.index);
        let camera = (&pair.right_camera, &pair.right_tiles);
        let truth = truth::disparities(&pair.scene, &pair.left, camera, rig.baseline_m() as f32, 5);
        // One sensor for both sides: gain differs between cameras on purpose.
        let sensor = Sensor::new(&world, 2, 3);
        let [left, right] = [&pair.left, &pair.right].map(|p| develop(&p.rgb, &sensor));
        let width = rig.width as usize;
        let error = |shift: f32| -> Vec<f32> {
            let mut errors = Vec::new();
            for (at, &stored) in truth.noc.iter().enumerate() {
                let x = (at % width) as f32 - f32::from(stored) / 256.0 - shift;
                if stored == 0 || x < 0.0 || x > (width - 2) as f32 {
                    continue;
                }
                let from = at / width * width + x as usize;
                let weight = x - (x as usize) as f32;
                let total: f32 = (0..3)
                    .map(|c| {
                        let near = f32::from(right[3 * from + c]);
                        let far = f32::from(right[3 * from + 3 + c]);
                        (near + (far - near) * weight - f32::from(left[3 * at + c])).abs()
                    })
                    .sum();
                errors.push(total / 3.0);
            }
            errors
        };
        let mut exact = error(0.0);
        let mut wrong = error(3.0);
        assert!(exact.len() > 4000, "{}: {}", shot.world, exact.len());
        let good = share(&exact, |e| e < 16.0);
        assert!(good > 0.85, "{} {}: {good}", shot.world, shot.index);
        let (exact, wrong) = (median(&mut exact), median(&mut wrong));
        assert!(
            exact < 5.0 && wrong > 1.6 * exact,
            "{} {exact} {wrong}",
            shot.world
        );
    }
}

#[test]
fn disparities_are_sparse_and_visible_ones_are_a_part_of_all() {
    let stage = &*STAGE;
    for shot in stage.shots.iter().rev().take(3) {
        let world = world_of(shot, 1);
        let rig = Stage::rig(shot);
        let pair = render_pair(&world, &stage.textures, rig, shot.index);
        let camera = (&pair.right_camera, &pair.right_tiles);
        let truth = truth::disparities(&pair.scene, &pair.left, camera, rig.baseline_m() as f32, 5);
        let count = |v: &[u16]| v.iter().filter(|&&d| d > 0).count() as f32;
        let filled = count(&truth.occ) / truth.occ.len() as f32;
        assert!((0.10..0.30).contains(&filled), "{}: {filled}", shot.world);
        assert!(
            count(&truth.noc) < count(&truth.occ) && count(&truth.noc) > 0.6 * count(&truth.occ)
        );
        assert!(
            truth
                .noc
                .iter()
                .zip(&truth.occ)
                .all(|(&n, &o)| n == 0 || n == o)
        );
        let top = rig.width as usize * rig.height as usize / 4;
        assert!(truth.occ[..top].iter().all(|&d| d == 0));
    }
}

#[test]
fn projected_scan_agrees_with_the_depth_of_the_picture() {
    let stage = &*STAGE;
    for shot in stage.shots.iter().step_by(5) {
        let world = world_of(shot, 1);
        let rig = Stage::rig(shot);
        let cam = CamToCam::parse(&rig.cam_to_cam()).expect("own calibration file");
        let velo = VeloToCam::parse(&rig.velo_to_cam()).expect("own calibration file");
        assert!((cam.baseline_m() - rig.baseline_m()).abs() < 1e-6);
        let scene = Scene::new(&world, &stage.textures, shot.index);
        let camera = rig.camera(&scene, 0);
        let tiles = Tiles::new(&scene, &camera);
        let picture = picture::render(&scene, &camera, &tiles);
        let (eye, axes) = rig.scanner(&scene);
        let lidar = Lidar {
            steps: 500,
            seed: 2,
        };
        let points = lidar.scan(&scene, eye, axes);
        let (width, height) = (rig.width as usize, rig.height as usize);
        let projection = velodyne_projection(&cam, &velo);
        let depth = velodyne_depth(&points, &projection, width, height, DepthAxis::CameraZ);
        let mut errors: Vec<f32> = depth
            .iter()
            .zip(&picture.depth_m)
            .filter(|(d, _)| **d > 0.0)
            .map(|(d, z)| (d - z).abs() / d)
            .collect();
        assert!(errors.len() > 3000, "{}: {}", shot.world, errors.len());
        // Pixels on outlines and within foliage see something else than the scanner.
        let good = share(&errors, |e| e < 0.05);
        assert!(good > 0.80, "{} {}: {good}", shot.world, shot.index);
        assert!(median(&mut errors) < 0.008, "{}", shot.world);
    }
}

fn tiny(out: &Path, jobs: usize, seed: u64) -> Result<u8> {
    run(&Options {
        preset: Preset::Tiny,
        seed,
        threads: jobs,
        quiet: true,
        out: out.to_owned(),
    })
}

fn contents(root: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut folders = vec![root.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in fs_err::read_dir(folder).expect("own folder") {
            let path = entry.expect("own folder").path();
            if path.is_dir() {
                folders.push(path);
            } else {
                let bytes = fs_err::read(&path).expect("own file");
                let name = path.strip_prefix(root).expect("below the root").to_owned();
                found.insert(name, bytes);
            }
        }
    }
    found
}

#[test]
fn bytes_depend_on_the_seed_alone_and_only_missing_files_are_rendered() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (one, three) = (folder.path().join("one"), folder.path().join("three"));
    assert_eq!(tiny(&one, 1, 1).expect("renders"), 0);
    assert_eq!(tiny(&three, 3, 1).expect("renders"), 0);
    let all = contents(&one);
    // 15 raw frames with two pictures and a scan, 3 scenes of 7 files, 5 days of 3 files, and what
    // says that they are rendered.
    assert_eq!(all.len(), 15 * 3 + 3 * 7 + 5 * 3 + 3);
    assert!(
        all == contents(&three),
        "the number of threads changed some bytes"
    );

    let training = Path::new("kitti2015/training");
    let lost = one.join(training).join("disp_noc_0/000002_10.png");
    let kept = one.join(training).join("image_2/000155_10.png");
    fs_err::remove_file(&lost).expect("is there");
    fs_err::write(&kept, b"untouched").expect("is there");
    assert_eq!(tiny(&one, 2, 1).expect("renders"), 0);
    assert_eq!(
        fs_err::read(&lost).expect("is back"),
        all[&training.join("disp_noc_0/000002_10.png")]
    );
    assert_eq!(fs_err::read(&kept).expect("is there"), b"untouched");

    let refusal = tiny(&one, 1, 2).expect_err("another seed").to_string();
    assert!(
        refusal.contains("seed 1") && refusal.contains("--out"),
        "{refusal}"
    );

    labels_cover_everything(&three);
}

/// Files of KITTI's names in a folder without a world, as a user's real data lie there.
fn real_data(root: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    for name in [
        "kitti_raw/2011_09_26/calib_cam_to_cam.txt",
        "kitti_raw/2011_09_26/2011_09_26_drive_0001_sync/image_02/data/0000000000.png",
        "kitti2015/training/image_2/000002_10.png",
    ] {
        let path = root.join(name);
        fs_err::create_dir_all(path.parent().expect("a folder")).expect("is made");
        fs_err::write(path, format!("recorded: {name}")).expect("is written");
    }
    contents(root)
}

#[test]
fn a_folder_of_other_things_is_never_touched() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let recorded = real_data(folder.path());
    let refusal = tiny(folder.path(), 1, 1).expect_err("real data");
    assert!(
        refusal
            .to_string()
            .contains("(kitti2015), which `prep synth` would replace"),
        "{refusal}"
    );
    assert!(matches!(CliError::from(refusal), CliError::Usage(_)));
    assert_eq!(contents(folder.path()), recorded);

    // Somebody else's file of the mark's name makes it no world.
    fs_err::write(folder.path().join("WORLD.yaml"), "population: 8e9\n").expect("is written");
    let refusal = tiny(folder.path(), 1, 1)
        .expect_err("real data")
        .to_string();
    assert!(refusal.contains("not written by `prep synth`"), "{refusal}");
    fs_err::remove_file(folder.path().join("WORLD.yaml")).expect("is there");
    assert_eq!(contents(folder.path()), recorded);
}

#[test]
fn real_data_within_a_world_stay() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let world = WorldFile::new(Preset::Tiny, 1, STAGE.shots.len());
    output::claim(folder.path(), &world).expect("an empty folder");
    let recorded = real_data(folder.path());
    let refusal = tiny(folder.path(), 1, 1)
        .expect_err("real calibration")
        .to_string();
    assert!(
        refusal.contains("calib_cam_to_cam.txt is not this world's"),
        "{refusal}"
    );
    assert_eq!(contents(folder.path()), recorded);
}

#[test]
fn what_a_killed_run_leaves_is_no_obstacle() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let leftover = folder.path().join(".unfinished-a1B2c3");
    fs_err::write(&leftover, "rendered: tr").expect("is written");
    let world = WorldFile::new(Preset::Tiny, 1, STAGE.shots.len());
    output::claim(folder.path(), &world).expect("its own leftover");
    assert!(!leftover.exists());
}

/// What is rendered in memory is what `prep synth` writes.
#[test]
fn a_single_view_is_the_frame_of_the_preset() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let renderer = Renderer::of(Preset::Tiny, 7);
    for shot in [&STAGE.shots[0], &STAGE.shots[STAGE.shots.len() - 1]] {
        let view = match shot.purpose {
            Purpose::Raw { frame, .. } => View::Frame(frame),
            Purpose::Stereo { number } => View::Stereo(number),
        };
        let rendered = renderer.render(view).expect("a view of KITTI");
        output::write(folder.path(), shot, &rendered).expect("is written");
        let files = output::targets(folder.path(), shot);
        let left = image_files::read_rgb(&files.left).expect("own picture");
        assert!(left == rendered.left);
        assert_eq!(files.scan.is_some(), rendered.scan.is_some());
        assert_eq!(files.truth.is_some(), rendered.truth.is_some());
        if let (Some(files), Some(truth)) = (&files.truth, &rendered.truth) {
            let (.., occ) = image_files::read_gray16(&files.occ).expect("own disparities");
            assert!(occ == truth.occ);
        }
        CamToCam::parse(&rendered.cam_to_cam).expect("own calibration");
        VeloToCam::parse(&rendered.velo_to_cam).expect("own calibration");
    }
    let frame = "2011_09_26_drive_0001/0000009999"
        .parse()
        .expect("a frame name");
    assert!(renderer.render(View::Frame(frame)).is_err());
    assert!(renderer.render(View::Stereo(200)).is_err());
}

/// All seven categories of PROTOCOL 1.3 appear, and instances carry their label.
fn labels_cover_everything(root: &Path) {
    let mut seen = [0_usize; 8];
    for number in ["000002", "000155", "000170"] {
        let file = |kind: &str| root.join(format!("kitti2015/training/{kind}/{number}_10.png"));
        let (width, height, labels) =
            image_files::read_gray8(&file("semantic")).expect("own labels");
        let (iw, ih, instances) = image_files::read_gray16(&file("instance")).expect("own labels");
        let picture = image_files::read_rgb(&file("image_2")).expect("own picture");
        assert_eq!((width, height), (iw, ih));
        assert_eq!((width as u32, height as u32), picture.dimensions());
        for (&label, &instance) in labels.iter().zip(&instances) {
            assert_eq!(u16::from(label), instance / 256);
            let category = match label {
                7..=10 => 1,
                11..=16 => 2,
                17..=20 => 3,
                21..=22 => 4,
                23 => 5,
                24..=25 => 6,
                26..=33 => 7,
                _ => 0,
            };
            seen[category] += 1;
        }
    }
    assert!(seen[1..].iter().all(|&n| n > 200), "{seen:?}");
}
