//! A whole input of each kind, small enough to be read a thousand times.

use std::fs::File;
use std::io::Write;

use strat_store::image_files;
use zip::write::SimpleFileOptions;

use crate::stage::{Stage, tree};

impl Stage {
    /// `small/`: one day of the rendered KITTI with one Eigen test frame; the path of its scan.
    pub fn small_raw(&self) -> String {
        let table = String::from_utf8(self.read("eigen/test.csv")).expect("a table is text");
        let id = table.lines().nth(1).and_then(|line| line.split(',').next());
        let (drive, frame) = id.and_then(|id| id.split_once('/')).expect("DRIVE/FRAME");
        let day = drive.get(..10).expect("a drive begins with its day");
        for name in ["cam_to_cam", "velo_to_cam", "imu_to_velo"] {
            let name = format!("{day}/calib_{name}.txt");
            self.copy(&format!("world/kitti_raw/{name}"), &format!("small/{name}"));
        }
        let folder = format!("{day}/{drive}_sync");
        let mut scan = String::new();
        for (kind, extension) in [
            ("image_02", "png"),
            ("image_03", "png"),
            ("velodyne_points", "bin"),
        ] {
            let name = format!("{folder}/{kind}/data/{frame}.{extension}");
            scan = format!("small/{name}");
            self.copy(&format!("world/kitti_raw/{name}"), &scan);
        }
        scan
    }

    /// `input/`: the rest. [`Stage::small_raw`] comes first.
    pub fn inputs(&self) {
        let photo = image_files::read_rgb(&self.path("photos/0.png")).expect("a photo");
        let (width, height) = photo.dimensions();
        self.copy("photos/0.png", "input/left.png");
        self.write("input/right.jpg", &image_files::encode_jpeg_rgb(&photo, 90));
        let depth = vec![2560; (width * height) as usize];
        self.write(
            "input/depth.png",
            &image_files::encode_png_gray16(width, height, &depth),
        );
        let exr = tree(&self.path("eigen/depth"))
            .into_iter()
            .find(|(name, _)| name.extension().is_some_and(|extension| extension == "exr"));
        self.write("input/depth.exr", &exr.expect("ground truth").1);
        for (list, truth) in [("pairs", "depth.png"), ("exr", "depth.exr")] {
            let text = format!(
                "left,right,focal_px,baseline_m,split,depth\nleft.png,right.jpg,240,0.54,test,{truth}\n"
            );
            self.write(&format!("input/{list}.csv"), text.as_bytes());
        }

        self.must(
            "bench --table 3.3 --data eigen --model a=a.onnx --save-predictions --runtime embedded --quiet \
             --out table",
        );
        for extension in ["npy", "ids.txt", "yaml"] {
            self.copy(
                &format!("table/predictions.{extension}"),
                &format!("input/maps.{extension}"),
            );
        }
        self.copy("table/rows.csv", "input/rows.csv");
        self.copy("table/leaderboard.csv", "input/board.csv");
        self.must("prep export eigen --kind velodyne --format npz --out truth");
        self.copy("truth/test-velodyne.npz", "input/arrays.npz");
        self.write("input/arrays.yaml", b"meaning: depth_m\n");

        self.copy("a.onnx", "input/a.onnx");
        self.copy("a.onnx", "input/m.onnx");
        self.write(
            "input/m.yaml",
            b"input: {width: 128, height: 64, range: 0..1, mean: [0.4, 0.5, 0.4], std: [0.2, 0.2, 0.2],\n\
              \x20        channels: rgb, layout: nchw, kernel: lanczos}\n\
              output: {meaning: disparity_fraction, channel: 0, layout: nchw}\n",
        );
        self.write(
            "input/protocol.yaml",
            b"name: mine\nbase: eigen-80\nmax_depth_m: 50\nmin_depth_m: 0.01\ncrop: garg\n",
        );
        for (name, bytes) in tree(&self.path("eigen")) {
            self.write(&format!("input/set/{}", name.display()), &bytes);
        }

        let image = image_files::encode_png_rgb(&photo);
        self.write("input/make3d/images/img-a.jpg", &image);
        self.write("input/make3d/depth/depth_sph_corr-a.mat", &grid());
        // Made by writing to it, with its folder.
        self.write("input/zips/all.zip", b"");
        let mut zip =
            zip::ZipWriter::new(File::create(self.path("input/zips/all.zip")).expect("a file"));
        for (name, bytes) in tree(&self.path("small")) {
            let name = name.to_str().expect("a name of KITTI");
            zip.start_file(name, SimpleFileOptions::default())
                .expect("an entry");
            zip.write_all(&bytes).expect("its bytes");
        }
        zip.finish().expect("an archive");
    }
}

/// A MATLAB 5 file of Make3D's grid, put together by the format's description.
fn grid() -> Vec<u8> {
    let element = |kind: u32, data: Vec<u8>| {
        let mut bytes = [kind.to_le_bytes(), (data.len() as u32).to_le_bytes()].concat();
        bytes.extend(data);
        bytes.resize(bytes.len().next_multiple_of(8), 0);
        bytes
    };
    let values = (0..55 * 305 * 4).map(|i| f64::from(i % 55) + 0.5);
    let matrix = [
        element(6, vec![6, 0, 0, 0, 0, 0, 0, 0]),
        element(
            5,
            [55_u32, 305, 4]
                .iter()
                .flat_map(|side| side.to_le_bytes())
                .collect(),
        ),
        element(1, b"Position3DGrid".to_vec()),
        element(9, values.flat_map(f64::to_le_bytes).collect()),
    ];
    let mut bytes = vec![b' '; 124];
    bytes.extend_from_slice(b"\x00\x01IM");
    bytes.extend(element(14, matrix.concat()));
    bytes
}
