//! Snapshots of the four formats, and the rules of what may stand in a table.

use super::*;
use crate::protocol::Group;
use crate::rows::RowsError;
use crate::rows::tests::sample;

fn coverage(expected_images: u64) -> Coverage {
    Coverage {
        expected_images,
        source: Source::Kitti,
    }
}

/// Rows of a model over images of three drives; `value` is abs_rel of the first image.
fn rows(model: &str, protocol: &str, images: u32, value: f64) -> Vec<Row> {
    (0..images)
        .map(|i| {
            let image = format!("2011_09_26_drive_{:04}/{i:010}", i % 3);
            let mut row = sample(model, protocol, &image, value + 0.001 * f64::from(i));
            if protocol == "kitti2015" {
                row.score.d1_all = Some(100.0 * value);
            }
            row
        })
        .collect()
}

/// A partial run of one model and of a baseline with an awkward name.
fn table_3_1() -> Table {
    let mut rows = [
        rows("StrAT", "kitti2015", 36, 0.1),
        rows("Median_depth & 5 % | [a](b)", "kitti2015", 36, 0.35),
    ]
    .concat();
    rows[0].score.floored_pixels = 7;
    for row in &mut rows[..36] {
        row.context.variant = Some("bottleneck".to_owned());
    }
    build(ThesisTable::Table31, &rows, &coverage(200)).unwrap()
}

/// Three seeds are one line with mean and sample standard deviation, by hand 0.102 +- 0.002; it
/// competes with its mean. One seed alone, and another method, stay lines of their own.
#[test]
fn seeds_of_one_method_share_a_line() {
    let rows = [
        rows("Ours@1", "eigen-80", 1, 0.100),
        rows("Other", "eigen-80", 1, 0.110),
        rows("Ours@2", "eigen-80", 1, 0.102),
        rows("Ours@3", "eigen-80", 1, 0.104),
        rows("Alone@1", "eigen-80", 1, 0.105),
    ]
    .concat();
    let table = build(ThesisTable::Table33, &rows, &coverage(1)).unwrap();
    let text = table.text();
    assert!(text.contains("Ours (3 seeds)"), "{text}");
    assert!(
        text.contains("[0.102]") && text.contains("±0.002"),
        "{text}"
    );
    assert!(
        text.contains("± of seeds: their standard deviation"),
        "{text}"
    );
    assert!(text.contains("over the seeds 1, 2, 3."), "{text}");
    assert!(
        text.contains("\n Alone@1") || text.contains("\nAlone@1"),
        "{text}"
    );
    let line_of_one = |line: &str| line.contains("Ours@1 ") && line.contains(" measured ");
    assert!(!text.lines().any(line_of_one), "{text}");
    // One image each makes no interval, and says so.
    assert!(
        text.contains(
            "Ours@1 under eigen-80: no intervals over 1 drive; it takes at least 3 of them."
        ),
        "{text}"
    );
}

fn table_3_3() -> Table {
    let rows = [
        rows("StrAT", "eigen-80", 4, 0.1),
        rows("StrAT", "eigen-50", 4, 0.09),
    ]
    .concat();
    build(ThesisTable::Table33, &rows, &coverage(4)).unwrap()
}

fn table_3_2() -> Table {
    let mut all = Vec::new();
    for (image, value) in [
        ("kitti2015/000000", 0.04),
        ("kitti2015/000002", 0.05),
        ("kitti2015/000199", 0.06),
    ] {
        for group in Group::SEMANTIC {
            // No people in the last image.
            if group == Group::Human && value > 0.05 {
                continue;
            }
            let mut row = sample("StrAT", "semantic", image, value);
            row.score.group = Some(group);
            all.push(row);
        }
    }
    build(ThesisTable::Table32, &all, &coverage(3)).unwrap()
}

#[test]
fn table_3_1_as_text() {
    insta::assert_snapshot!(table_3_1().text(), @r#"
    Table 3.1, KITTI split: 36 of 200 images; protocol kitti2015 a569e08a7e07; data 0f1e2d3c4b5a
    Only part of the images, so not ranked against published numbers.
    ───────────────────────────────────────────────────────────────────────────────────────────────────
    Method                       Abs Rel   Sq Rel     RMSE  RMSE log   δ<1.25  δ<1.25²  δ<1.25³  D1-all
                                       ↓      m ↓      m ↓         ↓        ↑        ↑        ↑     % ↓
    ───────────────────────────────────────────────────────────────────────────────────────────────────
    StrAT (bottleneck)             0.118    1.175    5.875     0.235    0.882    0.941    0.971  10.000
                                  ±0.002   ±0.025   ±0.124    ±0.005   ±0.002   ±0.001   ±0.001  ±0.000
    Median_depth & 5 % | [a](b)    0.367    3.675   18.375     0.735    0.632    0.816    0.908  35.000
                                  ±0.002   ±0.025   ±0.124    ±0.005   ±0.002   ±0.001   ±0.001  ±0.000
    published, not measured here:
    Yang et al. [83] *             0.172    1.559    6.794     0.252    0.744    0.910    0.969       -
    Godard et al. [21]             0.124    1.388    6.125     0.217    0.841    0.936    0.975       -
    Ours - No L_adv                0.118    1.124    5.916     0.211    0.835    0.936    0.975       -
    Ours - Fixed Baseline          0.115    1.154    5.766     0.205    0.846    0.944    0.979       -
    Ours - Random Baseline         0.112    1.089    5.636     0.201    0.850    0.946    0.980       -
    Ours - StrAT                 [0.108]  [1.019]  [5.551]   [0.195]  [0.856]  [0.950]  [0.981]       -
    ───────────────────────────────────────────────────────────────────────────────────────────────────
    ± half of the 95 % interval over 3 drives
    Brackets: best of the comparable rows, to three decimals. Numbers marked published are those printed in the thesis and were not measured here.
    Godard et al. [21] (row 2 of the printed table): VGG encoder, while the thesis' own rows use ResNet-50.
    Marks: * trained on monocular video.
    StrAT under kitti2015, 95 % intervals over 3 drives: Abs Rel 0.115 to 0.120, Sq Rel 1.150 to 1.200, RMSE 5.752 to 6.001, RMSE log 0.230 to 0.240, δ<1.25 0.880 to 0.885, δ<1.25² 0.940 to 0.942, δ<1.25³ 0.970 to 0.971, D1-all 10.000 to 10.000.
    StrAT under kitti2015: the disparity of 7 of 36000 pixels was raised to the floor.
    Median_depth & 5 % | [a](b) under kitti2015, 95 % intervals over 3 drives: Abs Rel 0.365 to 0.370, Sq Rel 3.650 to 3.700, RMSE 18.251 to 18.500, RMSE log 0.730 to 0.740, δ<1.25 0.630 to 0.635, δ<1.25² 0.815 to 0.817, δ<1.25³ 0.908 to 0.909, D1-all 35.000 to 35.000.
    "#);
}

#[test]
fn table_3_1_as_markdown() {
    insta::assert_snapshot!(table_3_1().markdown(), @r#"
    ### Table 3.1, KITTI split: 36 of 200 images; protocol kitti2015 a569e08a7e07; data 0f1e2d3c4b5a

    **Only part of the images, so not ranked against published numbers.**

    | Method | Origin | Supervision | Images | Abs Rel ↓ | Sq Rel m ↓ | RMSE m ↓ | RMSE log ↓ | δ&lt;1.25 ↑ | δ&lt;1.25² ↑ | δ&lt;1.25³ ↑ | D1-all % ↓ |
    | --- | --- | --- | --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |
    | StrAT (bottleneck) | measured | - | 36/200 | 0.118 | 1.175 | 5.875 | 0.235 | 0.882 | 0.941 | 0.971 | 10.000 |
    | Median\_depth &amp; 5 % \| [a\](b) | measured | - | 36/200 | 0.367 | 3.675 | 18.375 | 0.735 | 0.632 | 0.816 | 0.908 | 35.000 |
    | Yang et al. [83] \* | published | monocular video | - | 0.172 | 1.559 | 6.794 | 0.252 | 0.744 | 0.910 | 0.969 | - |
    | Godard et al. [21] | published | stereo | - | 0.124 | 1.388 | 6.125 | 0.217 | 0.841 | 0.936 | 0.975 | - |
    | Ours - No L\_adv | published | stereo | - | 0.118 | 1.124 | 5.916 | 0.211 | 0.835 | 0.936 | 0.975 | - |
    | Ours - Fixed Baseline | published | stereo | - | 0.115 | 1.154 | 5.766 | 0.205 | 0.846 | 0.944 | 0.979 | - |
    | Ours - Random Baseline | published | stereo | - | 0.112 | 1.089 | 5.636 | 0.201 | 0.850 | 0.946 | 0.980 | - |
    | Ours - StrAT | published | stereo | - | **0.108** | **1.019** | **5.551** | **0.195** | **0.856** | **0.950** | **0.981** | - |

    - Bold: best of the comparable rows, to three decimals. Numbers marked published are those printed in the thesis and were not measured here.
    - Godard et al. [21] (row 2 of the printed table): VGG encoder, while the thesis' own rows use ResNet-50.
    - Marks: \* trained on monocular video.
    - StrAT under kitti2015, 95 % intervals over 3 drives: Abs Rel 0.115 to 0.120, Sq Rel 1.150 to 1.200, RMSE 5.752 to 6.001, RMSE log 0.230 to 0.240, δ&lt;1.25 0.880 to 0.885, δ&lt;1.25² 0.940 to 0.942, δ&lt;1.25³ 0.970 to 0.971, D1-all 10.000 to 10.000.
    - StrAT under kitti2015: the disparity of 7 of 36000 pixels was raised to the floor.
    - Median\_depth &amp; 5 % \| [a\](b) under kitti2015, 95 % intervals over 3 drives: Abs Rel 0.365 to 0.370, Sq Rel 3.650 to 3.700, RMSE 18.251 to 18.500, RMSE log 0.730 to 0.740, δ&lt;1.25 0.630 to 0.635, δ&lt;1.25² 0.815 to 0.817, δ&lt;1.25³ 0.908 to 0.909, D1-all 35.000 to 35.000.
    "#);
}

#[test]
fn table_3_1_as_latex() {
    insta::assert_snapshot!(table_3_1().latex(), @r#"
    % Table 3.1, KITTI split: 36 of 200 images; protocol kitti2015 a569e08a7e07; data 0f1e2d3c4b5a
    % kitti2015 digest a569e08a7e07ac2d32b57a77b85b605f0e5032c44a71f3e848373bc9b4eaa889; data 0f1e2d3c4b5a69788796a5b4c3d2e1f0
    % Godard et al. [21] (row 2 of the printed table): VGG encoder, while the thesis' own rows use ResNet-50.
    % Marks: * trained on monocular video.
    % StrAT under kitti2015, 95 % intervals over 3 drives: Abs Rel 0.115 to 0.120, Sq Rel 1.150 to 1.200, RMSE 5.752 to 6.001, RMSE log 0.230 to 0.240, δ<1.25 0.880 to 0.885, δ<1.25² 0.940 to 0.942, δ<1.25³ 0.970 to 0.971, D1-all 10.000 to 10.000.
    % StrAT under kitti2015: the disparity of 7 of 36000 pixels was raised to the floor.
    % Median_depth & 5 % | [a](b) under kitti2015, 95 % intervals over 3 drives: Abs Rel 0.365 to 0.370, Sq Rel 3.650 to 3.700, RMSE 18.251 to 18.500, RMSE log 0.730 to 0.740, δ<1.25 0.630 to 0.635, δ<1.25² 0.815 to 0.817, δ<1.25³ 0.908 to 0.909, D1-all 35.000 to 35.000.
    % Needs \usepackage{booktabs} and \usepackage{xcolor}. The keys of \cite are in
    % table_references.bib: \bibliography{table_references}
    \providecommand{\best}[1]{\textbf{#1}}
    \providecommand{\second}[1]{\underline{#1}}
    \begin{table*}
    \centering\footnotesize
    \setlength{\tabcolsep}{3pt}
    \caption{KITTI split: 36 of 200 images; \texttt{kitti2015}. Only part of the images, so not ranked against published numbers. Bold: best, underlined: second best of the comparable rows. Cited rows are as published. Marks: {*} trained on monocular video.}
    \label{tab:strat-3-1}
    \begin{tabular}{p{79pt}rrrrrrrr}
    \toprule
    Method & \shortstack[r]{Abs Rel\\$\downarrow$} & \shortstack[r]{Sq Rel\\m $\downarrow$} & \shortstack[r]{RMSE\\m $\downarrow$} & \shortstack[r]{RMSE\\log\\$\downarrow$} & \shortstack[r]{$\delta$$<$1.25\\$\uparrow$} & \shortstack[r]{$\delta$$<$1.25$^2$\\$\uparrow$} & \shortstack[r]{$\delta$$<$1.25$^3$\\$\uparrow$} & \shortstack[r]{D1-all\\\% $\downarrow$} \\
    \midrule
    StrAT (bottleneck) & 0.118 & 1.175 & 5.875 & 0.235 & 0.882 & 0.941 & 0.971 & 10.000 \\
    Median\_\allowbreak{}depth \& 5 \% \textbar{} {[}a{]}(b) & 0.367 & 3.675 & 18.375 & 0.735 & 0.632 & 0.816 & 0.908 & 35.000 \\
    \addlinespace
    Yang et al.$^{*}$~\cite{yang2018} & 0.172 & 1.559 & 6.794 & 0.252 & 0.744 & 0.910 & 0.969 & - \\
    Godard et al.~\cite{godard2017} & 0.124 & 1.388 & 6.125 & 0.217 & 0.841 & 0.936 & 0.975 & - \\
    Ours - No L\_\allowbreak{}adv~\cite{mehta2018} & 0.118 & 1.124 & 5.916 & 0.211 & 0.835 & 0.936 & 0.975 & - \\
    Ours - Fixed Baseline~\cite{mehta2018} & 0.115 & 1.154 & 5.766 & 0.205 & 0.846 & 0.944 & 0.979 & - \\
    Ours - Random Baseline~\cite{mehta2018} & \second{0.112} & \second{1.089} & \second{5.636} & \second{0.201} & \second{0.850} & \second{0.946} & \second{0.980} & - \\
    Ours - StrAT~\cite{mehta2018} & \best{0.108} & \best{1.019} & \best{5.551} & \best{0.195} & \best{0.856} & \best{0.950} & \best{0.981} & - \\
    \bottomrule
    \end{tabular}
    \end{table*}
    "#);
}

#[test]
fn table_3_1_as_csv() {
    insta::assert_snapshot!(table_3_1().csv().unwrap(), @r#"
    table,section,method,origin,supervision,images,abs_rel,sq_rel,rmse,rmse_log,a1,a2,a3,d1_all,grey,protocol,protocol_digest,data_digest,expected_images
    3.1,,StrAT (bottleneck),measured,,36,0.11750000000000001,1.175,5.875,0.23500000000000001,0.8825,0.9412499999999999,0.9706249999999998,10,false,kitti2015,a569e08a7e07ac2d32b57a77b85b605f0e5032c44a71f3e848373bc9b4eaa889,0f1e2d3c4b5a69788796a5b4c3d2e1f0,200
    3.1,,Median_depth & 5 % | [a](b),measured,,36,0.3675,3.6750000000000003,18.375,0.735,0.6325,0.8162499999999999,0.9081249999999998,35,false,kitti2015,a569e08a7e07ac2d32b57a77b85b605f0e5032c44a71f3e848373bc9b4eaa889,0f1e2d3c4b5a69788796a5b4c3d2e1f0,200
    3.1,,Yang et al. [83],published,monocular video,,0.172,1.559,6.794,0.252,0.744,0.91,0.969,,false,kitti2015,,,
    3.1,,Godard et al. [21],published,stereo,,0.124,1.388,6.125,0.217,0.841,0.936,0.975,,false,kitti2015,,,
    3.1,,Ours - No L_adv,published,stereo,,0.118,1.124,5.916,0.211,0.835,0.936,0.975,,false,kitti2015,,,
    3.1,,Ours - Fixed Baseline,published,stereo,,0.115,1.154,5.766,0.205,0.846,0.944,0.979,,false,kitti2015,,,
    3.1,,Ours - Random Baseline,published,stereo,,0.112,1.089,5.636,0.201,0.85,0.946,0.98,,false,kitti2015,,,
    3.1,,Ours - StrAT,published,stereo,,0.108,1.019,5.551,0.195,0.856,0.95,0.981,,false,kitti2015,,,
    "#);
}

#[test]
fn table_3_3_as_text() {
    insta::assert_snapshot!(table_3_3().text(), @r#"
    Table 3.3, Eigen split: 4 of 4 images; protocol eigen-80 2bc91e5df36c, eigen-50 c64c43f21b30; data 0f1e2d3c4b5a
    ──────────────────────────────────────────────────────────────────────────────────────────
    Method                      Abs Rel   Sq Rel     RMSE  RMSE log   δ<1.25  δ<1.25²  δ<1.25³
                                      ↓      m ↓      m ↓         ↓        ↑        ↑        ↑
    ──────────────────────────────────────────────────────────────────────────────────────────
    Up to 80 m (eigen-80)
    StrAT                       [0.102]    1.015    5.075     0.203    0.899    0.949    0.975
                                 ±0.001   ±0.010   ±0.051    ±0.002   ±0.001   ±0.001   ±0.000
    published, not measured here:
    Eigen et al. - Fine [16] *    0.203    1.548    6.307     0.282    0.702    0.890    0.958
    Liu et al. [47] *             0.202    1.614    6.523     0.275    0.678    0.895    0.965
    Kuznietsov et al. [39] *      0.122  [0.763]    4.815   [0.194]    0.845    0.957  [0.987]
    Amir et al. [7] †             0.110    0.929  [4.726]   [0.194]  [0.923]  [0.967]    0.984
    Zhou et al. [90]              0.183    1.595    6.709     0.270    0.734    0.902    0.959
    Yang et al. [83]              0.182    1.481    6.501     0.267    0.725    0.906    0.963
    Godard et al. [21]            0.148    1.344    5.927     0.247    0.803    0.922    0.964
    Zhan et al. [86]              0.135    1.132    5.585     0.229    0.820    0.933    0.971
    Ours - StrAT                  0.128    1.019    5.403     0.227    0.827    0.935    0.971
    Poggi et al. [59] (later)     0.129    0.996    5.281     0.223    0.831    0.939    0.974
    Aleotti et al. [3] (later)    0.118    0.908    4.978     0.210    0.855    0.948    0.976

    Up to 50 m (eigen-50)
    StrAT                       [0.091]    0.915    4.575   [0.183]  [0.908]  [0.954]  [0.977]
                                 ±0.001   ±0.010   ±0.051    ±0.002   ±0.001   ±0.001   ±0.000
    published, not measured here:
    Zhou et al. [90]              0.201    1.391    5.181     0.264    0.696    0.900    0.966
    Garg et al. [19]              0.169    1.080    5.104     0.273    0.740    0.904    0.962
    Godard et al. [21]            0.140    0.976    4.471     0.232    0.818    0.931    0.969
    Zhan et al. [86]              0.128    0.815    4.366     0.225    0.818    0.937    0.973
    Ours - StrAT                  0.122  [0.768]  [4.095]     0.214    0.842    0.943    0.974
    Aleotti et al. [3] (later)    0.112    0.673    3.804     0.198    0.868    0.953    0.979
    ──────────────────────────────────────────────────────────────────────────────────────────
    ± half of the 95 % interval over 3 drives
    Brackets: best of the comparable rows, to three decimals. Numbers marked published are those printed in the thesis and were not measured here.
    Eigen et al. - Fine [16] (row 1 of the printed table): own crop, not the one of Garg et al.
    Amir et al. [7] (row 4 of the printed table): the method of Atapour-Abarghouei and Breckon.
    Zhou et al. [90] (row 5 of the printed table): a later public model of the authors; their row at 50 m is the model of the paper.
    Godard et al. [21] (row 7 of the printed table): VGG encoder, no post-processing.
    Aleotti et al. [3] (row 11 of the printed table): by later reports trained on more data than KITTI (not checked).
    Zhou et al. [90] (row 12 of the printed table): the model of the paper; the authors' row at 80 m is a later one.
    Zhan et al. [86] (row 15 of the printed table): the first two figures and the other five seem to come from two models of that paper.
    Aleotti et al. [3] (row 17 of the printed table): by later reports trained on more data than KITTI (not checked).
    Marks: * trained with measured depth, † with synthetic images and their depth. Rows trained on monocular video were scaled by medians. Rows marked later are printed in grey in the thesis and appeared after its paper.
    StrAT under eigen-80, 95 % intervals over 3 drives: Abs Rel 0.100 to 0.103, Sq Rel 1.005 to 1.025, RMSE 5.024 to 5.127, RMSE log 0.201 to 0.205, δ<1.25 0.897 to 0.900, δ<1.25² 0.949 to 0.950, δ<1.25³ 0.974 to 0.975.
    StrAT under eigen-50, 95 % intervals over 3 drives: Abs Rel 0.090 to 0.093, Sq Rel 0.905 to 0.925, RMSE 4.524 to 4.627, RMSE log 0.181 to 0.185, δ<1.25 0.907 to 0.910, δ<1.25² 0.954 to 0.955, δ<1.25³ 0.977 to 0.977.
    "#);
}

#[test]
fn table_3_3_as_latex() {
    insta::assert_snapshot!(table_3_3().latex(), @r#"
    % Table 3.3, Eigen split: 4 of 4 images; protocol eigen-80 2bc91e5df36c, eigen-50 c64c43f21b30; data 0f1e2d3c4b5a
    % eigen-80 digest 2bc91e5df36c305fb69912f774374ae1a5a54c2debb6d83c21bef3b25cbfa8db; data 0f1e2d3c4b5a69788796a5b4c3d2e1f0
    % eigen-50 digest c64c43f21b30cf5fbc3105033b6770af18a5e803b1fc426dc7974275877ab049; data 0f1e2d3c4b5a69788796a5b4c3d2e1f0
    % Eigen et al. - Fine [16] (row 1 of the printed table): own crop, not the one of Garg et al.
    % Amir et al. [7] (row 4 of the printed table): the method of Atapour-Abarghouei and Breckon.
    % Zhou et al. [90] (row 5 of the printed table): a later public model of the authors; their row at 50 m is the model of the paper.
    % Godard et al. [21] (row 7 of the printed table): VGG encoder, no post-processing.
    % Aleotti et al. [3] (row 11 of the printed table): by later reports trained on more data than KITTI (not checked).
    % Zhou et al. [90] (row 12 of the printed table): the model of the paper; the authors' row at 80 m is a later one.
    % Zhan et al. [86] (row 15 of the printed table): the first two figures and the other five seem to come from two models of that paper.
    % Aleotti et al. [3] (row 17 of the printed table): by later reports trained on more data than KITTI (not checked).
    % Marks: * trained with measured depth, † with synthetic images and their depth. Rows trained on monocular video were scaled by medians. Rows marked later are printed in grey in the thesis and appeared after its paper.
    % StrAT under eigen-80, 95 % intervals over 3 drives: Abs Rel 0.100 to 0.103, Sq Rel 1.005 to 1.025, RMSE 5.024 to 5.127, RMSE log 0.201 to 0.205, δ<1.25 0.897 to 0.900, δ<1.25² 0.949 to 0.950, δ<1.25³ 0.974 to 0.975.
    % StrAT under eigen-50, 95 % intervals over 3 drives: Abs Rel 0.090 to 0.093, Sq Rel 0.905 to 0.925, RMSE 4.524 to 4.627, RMSE log 0.181 to 0.185, δ<1.25 0.907 to 0.910, δ<1.25² 0.954 to 0.955, δ<1.25³ 0.977 to 0.977.
    % Needs \usepackage{booktabs} and \usepackage{xcolor}. The keys of \cite are in
    % table_references.bib: \bibliography{table_references}
    \providecommand{\best}[1]{\textbf{#1}}
    \providecommand{\second}[1]{\underline{#1}}
    \begin{table*}
    \centering\footnotesize
    \setlength{\tabcolsep}{3pt}
    \caption{Eigen split: 4 of 4 images; \texttt{eigen-80}, \texttt{eigen-50}. Bold: best, underlined: second best of the comparable rows. Cited rows are as published. Marks: {*} trained with measured depth, $\dagger$ with synthetic images and their depth. Rows trained on monocular video were scaled by medians. Rows marked later are printed in grey in the thesis and appeared after its paper.}
    \label{tab:strat-3-3}
    \begin{tabular}{lrrrrrrr}
    \toprule
    Method & \shortstack[r]{Abs Rel\\$\downarrow$} & \shortstack[r]{Sq Rel\\m $\downarrow$} & \shortstack[r]{RMSE\\m $\downarrow$} & \shortstack[r]{RMSE\\log\\$\downarrow$} & \shortstack[r]{$\delta$$<$1.25\\$\uparrow$} & \shortstack[r]{$\delta$$<$1.25$^2$\\$\uparrow$} & \shortstack[r]{$\delta$$<$1.25$^3$\\$\uparrow$} \\
    \midrule
    \multicolumn{8}{l}{\textit{Up to 80 m (eigen-80)}} \\
    StrAT & \best{0.102} & 1.015 & 5.075 & \second{0.203} & \second{0.899} & 0.949 & 0.975 \\
    \addlinespace
    Eigen et al. - Fine$^{*}$~\cite{eigen2014} & 0.203 & 1.548 & 6.307 & 0.282 & 0.702 & 0.890 & 0.958 \\
    Liu et al.$^{*}$~\cite{liu2016} & 0.202 & 1.614 & 6.523 & 0.275 & 0.678 & 0.895 & 0.965 \\
    Kuznietsov et al.$^{*}$~\cite{kuznietsov2017} & 0.122 & \best{0.763} & \second{4.815} & \best{0.194} & 0.845 & \second{0.957} & \best{0.987} \\
    Amir et al.$^{\dagger}$~\cite{atapour2018} & \second{0.110} & \second{0.929} & \best{4.726} & \best{0.194} & \best{0.923} & \best{0.967} & \second{0.984} \\
    Zhou et al.~\cite{zhou2017} & 0.183 & 1.595 & 6.709 & 0.270 & 0.734 & 0.902 & 0.959 \\
    Yang et al.~\cite{yang2018} & 0.182 & 1.481 & 6.501 & 0.267 & 0.725 & 0.906 & 0.963 \\
    Godard et al.~\cite{godard2017} & 0.148 & 1.344 & 5.927 & 0.247 & 0.803 & 0.922 & 0.964 \\
    Zhan et al.~\cite{zhan2018} & 0.135 & 1.132 & 5.585 & 0.229 & 0.820 & 0.933 & 0.971 \\
    Ours - StrAT~\cite{mehta2018} & 0.128 & 1.019 & 5.403 & 0.227 & 0.827 & 0.935 & 0.971 \\
    \textcolor{gray}{Poggi et al.~\cite{poggi2018}} & \textcolor{gray}{0.129} & \textcolor{gray}{0.996} & \textcolor{gray}{5.281} & \textcolor{gray}{0.223} & \textcolor{gray}{0.831} & \textcolor{gray}{0.939} & \textcolor{gray}{0.974} \\
    \textcolor{gray}{Aleotti et al.~\cite{aleotti2018}} & \textcolor{gray}{0.118} & \textcolor{gray}{0.908} & \textcolor{gray}{4.978} & \textcolor{gray}{0.210} & \textcolor{gray}{0.855} & \textcolor{gray}{0.948} & \textcolor{gray}{0.976} \\
    \midrule
    \multicolumn{8}{l}{\textit{Up to 50 m (eigen-50)}} \\
    StrAT & \best{0.091} & 0.915 & 4.575 & \best{0.183} & \best{0.908} & \best{0.954} & \best{0.977} \\
    \addlinespace
    Zhou et al.~\cite{zhou2017} & 0.201 & 1.391 & 5.181 & 0.264 & 0.696 & 0.900 & 0.966 \\
    Garg et al.~\cite{garg2016} & 0.169 & 1.080 & 5.104 & 0.273 & 0.740 & 0.904 & 0.962 \\
    Godard et al.~\cite{godard2017} & 0.140 & 0.976 & 4.471 & 0.232 & 0.818 & 0.931 & 0.969 \\
    Zhan et al.~\cite{zhan2018} & 0.128 & \second{0.815} & \second{4.366} & 0.225 & 0.818 & 0.937 & 0.973 \\
    Ours - StrAT~\cite{mehta2018} & \second{0.122} & \best{0.768} & \best{4.095} & \second{0.214} & \second{0.842} & \second{0.943} & \second{0.974} \\
    \textcolor{gray}{Aleotti et al.~\cite{aleotti2018}} & \textcolor{gray}{0.112} & \textcolor{gray}{0.673} & \textcolor{gray}{3.804} & \textcolor{gray}{0.198} & \textcolor{gray}{0.868} & \textcolor{gray}{0.953} & \textcolor{gray}{0.979} \\
    \bottomrule
    \end{tabular}
    \end{table*}
    "#);
}

#[test]
fn table_3_2_as_text() {
    insta::assert_snapshot!(table_3_2().text(), @r#"
    Table 3.2, RMSE in metres by semantic group: 3 of 3 images; protocol semantic 300e54cd8005; data 0f1e2d3c4b5a
    ───────────────────────────────────────────────────────────────────────────────
    Group           Godard et       Ours -       Ours -       StrAT  Images  Pixels
                     al. [21]  Photometric  Adversarial  (measured)
                  (published)  (published)  (published)         m ↓
                          m ↓          m ↓          m ↓
    ───────────────────────────────────────────────────────────────────────────────
    Mean over the images that contain the group
    Flat                2.165        2.376      [2.149]       2.500       3    3000
                                                             ±1.294
    Human               3.190        2.763        2.770     [2.250]       2    2000
    Vehicle             3.690        3.968        3.507     [2.500]       3    3000
                                                             ±1.294
    Construction        9.713        9.936        9.364     [2.500]       3    3000
                                                             ±1.294
    Object             12.763       11.789       11.537     [2.500]       3    3000
                                                             ±1.294

    Root of the mean over all pixels of the group
    Flat                    -            -            -       2.533       3    3000
                                                             ±1.277
    Human                   -            -            -       2.264       2    2000
    Vehicle                 -            -            -       2.533       3    3000
                                                             ±1.277
    Construction            -            -            -       2.533       3    3000
                                                             ±1.277
    Object                  -            -            -       2.533       3    3000
                                                             ±1.277
    ───────────────────────────────────────────────────────────────────────────────
    ± half of the 95 % interval over 2 drives and 1 run of scenes of unknown drive
    Brackets: best of the comparable rows, to three decimals. Numbers marked published are those printed in the thesis and were not measured here.
    StrAT under semantic, mean over the images that contain the group, 95 % intervals over drives or runs of scenes (how many in brackets): Flat 1.521 to 4.109 (3), Human none (2; it takes at least 3 of them), Vehicle 1.521 to 4.109 (3), Construction 1.521 to 4.109 (3), Object 1.521 to 4.109 (3).
    StrAT under semantic, root of the mean over all pixels of the group, 95 % intervals over drives or runs of scenes (how many in brackets): Flat 1.560 to 4.113 (3), Human none (2; it takes at least 3 of them), Vehicle 1.560 to 4.113 (3), Construction 1.560 to 4.113 (3), Object 1.560 to 4.113 (3).
    The thesis does not say how it averaged; its numbers stand beside the mean over images. Its text calls the adversarial model better in every group, but for Human its table has 2.770 against 2.763 without the adversarial term.
    "#);
}

#[test]
fn table_3_2_as_markdown() {
    insta::assert_snapshot!(table_3_2().markdown(), @r#"
    ### Table 3.2, RMSE in metres by semantic group: 3 of 3 images; protocol semantic 300e54cd8005; data 0f1e2d3c4b5a

    | Group | Godard et al. [21] (published) m ↓ | Ours - Photometric (published) m ↓ | Ours - Adversarial (published) m ↓ | StrAT (measured) m ↓ | Images | Pixels |
    | --- | ---: | ---: | ---: | ---: | ---: | ---: |
    | **Mean over the images that contain the group** |  |  |  |  |  |  |
    | Flat | 2.165 | 2.376 | **2.149** | 2.500 | 3 | 3000 |
    | Human | 3.190 | 2.763 | 2.770 | **2.250** | 2 | 2000 |
    | Vehicle | 3.690 | 3.968 | 3.507 | **2.500** | 3 | 3000 |
    | Construction | 9.713 | 9.936 | 9.364 | **2.500** | 3 | 3000 |
    | Object | 12.763 | 11.789 | 11.537 | **2.500** | 3 | 3000 |
    | **Root of the mean over all pixels of the group** |  |  |  |  |  |  |
    | Flat | - | - | - | 2.533 | 3 | 3000 |
    | Human | - | - | - | 2.264 | 2 | 2000 |
    | Vehicle | - | - | - | 2.533 | 3 | 3000 |
    | Construction | - | - | - | 2.533 | 3 | 3000 |
    | Object | - | - | - | 2.533 | 3 | 3000 |

    - Bold: best of the comparable rows, to three decimals. Numbers marked published are those printed in the thesis and were not measured here.
    - StrAT under semantic, mean over the images that contain the group, 95 % intervals over drives or runs of scenes (how many in brackets): Flat 1.521 to 4.109 (3), Human none (2; it takes at least 3 of them), Vehicle 1.521 to 4.109 (3), Construction 1.521 to 4.109 (3), Object 1.521 to 4.109 (3).
    - StrAT under semantic, root of the mean over all pixels of the group, 95 % intervals over drives or runs of scenes (how many in brackets): Flat 1.560 to 4.113 (3), Human none (2; it takes at least 3 of them), Vehicle 1.560 to 4.113 (3), Construction 1.560 to 4.113 (3), Object 1.560 to 4.113 (3).
    - The thesis does not say how it averaged; its numbers stand beside the mean over images. Its text calls the adversarial model better in every group, but for Human its table has 2.770 against 2.763 without the adversarial term.
    "#);
}

#[test]
fn published_numbers_of_ones_own_are_a_column_of_table_3_2() {
    let text = "method,protocol,group,citation,rmse,rmse_pooled\n\
                Mine,semantic,human,\"A. B., 2024\",2.1,2.6\n\
                Mine,semantic,flat,\"A. B., 2024\",1.1,\n\
                Other,semantic,flat,\"C. D., 2025\",1.2,\n\
                Other,eigen-80,,\"C. D., 2025\",1.2,\n";
    let rows = crate::baselines::read(text.as_bytes()).unwrap();
    let table = table_3_2().with_published(&rows);
    let names: Vec<&str> = table
        .columns()
        .iter()
        .map(|one| one.heading.as_str())
        .collect();
    assert_eq!(
        names[3..7],
        [
            "Ours - Adversarial (published)",
            "Mine (published)",
            "Other (published)",
            "StrAT (measured)"
        ]
    );
    let cells = |section: usize, line: usize| -> Vec<&str> {
        let line = &table.sections()[section].lines[line];
        line.cells.iter().map(|cell| cell.text.as_str()).collect()
    };
    assert_eq!(cells(0, 0)[3..7], ["2.149", "1.100", "1.200", "2.500"]);
    assert_eq!(cells(0, 1)[3..7], ["2.770", "2.100", "-", "2.250"]);
    assert_eq!(cells(1, 1)[3..7], ["-", "2.600", "-", "2.264"]);
    // Never ranked: the thesis' number is still the best.
    assert!(table.sections()[0].lines[0].cells[3].best);
    assert!(
        table
            .notes()
            .contains(&"Mine, published: A. B., 2024.".to_owned())
    );
    assert!(
        table
            .text()
            .contains("printed in the thesis or in the works named below")
    );
    let shown: Shown = "Mine,StrAT".parse().unwrap();
    let few = table.only(&shown);
    let names: Vec<&str> = few
        .columns()
        .iter()
        .map(|one| one.heading.as_str())
        .collect();
    assert_eq!(names[1..3], ["Mine (published)", "StrAT (measured)"]);
}

#[test]
fn published_rows_alone() {
    let table = build(ThesisTable::Table31, &[], &coverage(200)).unwrap();
    insta::assert_snapshot!(table.text(), @r#"
    Table 3.1, KITTI split: 0 of 200 images, nothing measured; protocol kitti2015 a569e08a7e07
    ──────────────────────────────────────────────────────────────────────────────────────
    Method                  Abs Rel   Sq Rel     RMSE  RMSE log   δ<1.25  δ<1.25²  δ<1.25³
                                  ↓      m ↓      m ↓         ↓        ↑        ↑        ↑
    ──────────────────────────────────────────────────────────────────────────────────────
    Yang et al. [83] *        0.172    1.559    6.794     0.252    0.744    0.910    0.969
    Godard et al. [21]        0.124    1.388    6.125     0.217    0.841    0.936    0.975
    Ours - No L_adv           0.118    1.124    5.916     0.211    0.835    0.936    0.975
    Ours - Fixed Baseline     0.115    1.154    5.766     0.205    0.846    0.944    0.979
    Ours - Random Baseline    0.112    1.089    5.636     0.201    0.850    0.946    0.980
    Ours - StrAT            [0.108]  [1.019]  [5.551]   [0.195]  [0.856]  [0.950]  [0.981]
    ──────────────────────────────────────────────────────────────────────────────────────
    Brackets: best of the comparable rows, to three decimals. Numbers marked published are those printed in the thesis and were not measured here.
    Godard et al. [21] (row 2 of the printed table): VGG encoder, while the thesis' own rows use ResNet-50.
    Marks: * trained on monocular video.
    "#);
}

/// Text of the cell of a method in a column, with its brackets.
fn best_methods(table: &Table, key: &str) -> Vec<String> {
    let index = table
        .columns
        .iter()
        .position(|column| column.key == key)
        .unwrap();
    let lines = table.sections.iter().flat_map(|section| &section.lines);
    lines
        .filter(|line| line.cells[index].best)
        .map(|line| line.cells[0].text.clone())
        .collect()
}

#[test]
fn only_complete_measurements_of_the_real_data_compete() {
    let good = rows("New", "kitti2015", 3, 0.05);
    let best = |coverage: &Coverage| {
        best_methods(
            &build(ThesisTable::Table31, &good, coverage).unwrap(),
            "abs_rel",
        )
    };
    assert_eq!(best(&coverage(3)), ["New"]);
    assert_eq!(best(&coverage(4)), ["Ours - StrAT"]);
    let rendered = Coverage {
        expected_images: 3,
        source: Source::Rendered,
    };
    assert_eq!(best(&rendered), ["Ours - StrAT"]);
    let text = build(ThesisTable::Table31, &good, &rendered)
        .unwrap()
        .text();
    assert!(
        text.contains("The images are rendered, not KITTI"),
        "{text}"
    );
}

#[test]
fn grey_rows_and_own_crops_do_not_compete_and_ties_share() {
    let table = table_3_3();
    // Grey Aleotti has 0.118, Amir et al. 0.110 at 80 m; measured 0.1015 and 0.0915.
    assert_eq!(best_methods(&table, "abs_rel"), ["StrAT", "StrAT"]);
    let table = build(ThesisTable::Table33, &[], &coverage(697)).unwrap();
    assert_eq!(
        best_methods(&table, "abs_rel"),
        ["Amir et al. [7]", "Ours - StrAT"]
    );
    assert_eq!(
        best_methods(&table, "rmse_log"),
        ["Kuznietsov et al. [39]", "Amir et al. [7]", "Ours - StrAT"]
    );
    assert_eq!(
        best_methods(&table, "a1"),
        ["Amir et al. [7]", "Ours - StrAT"]
    );
}

#[test]
fn other_protocols_are_shown_but_not_compared() {
    let rows = rows("New", "eigen-cameraz-80", 3, 0.05);
    let protocols = ["eigen-cameraz-80", "eigen-cameraz-50"];
    let table = build_with(ThesisTable::Table33, &protocols, &rows, &coverage(3)).unwrap();
    assert!(best_methods(&table, "abs_rel").is_empty());
    let text = table.text();
    assert!(text.starts_with("Table 3.3, Eigen split: 3 of 3 images; protocol eigen-cameraz-80 "));
    assert!(text.contains("Measured under eigen-cameraz-80, published under eigen-80"));
    assert!(matches!(
        build_with(ThesisTable::Table33, &["eigen-80"], &rows, &coverage(3)),
        Err(TableError::Sections { .. })
    ));
}

#[test]
fn the_first_line_counts_each_model() {
    let rows = [
        rows("A", "kitti2015", 36, 0.1),
        rows("B", "kitti2015", 200, 0.1),
    ]
    .concat();
    let table = build(ThesisTable::Table31, &rows, &coverage(200)).unwrap();
    assert_eq!(
        table.first_line(),
        "Table 3.1, KITTI split: 36 of 200 images for A under kitti2015, 200 of 200 images for B \
         under kitti2015; protocol kitti2015 a569e08a7e07; data 0f1e2d3c4b5a"
    );
}

#[test]
fn rows_of_other_rules_or_data_are_refused() {
    let good = rows("A", "kitti2015", 3, 0.1);
    let refuse = |rows: &[Row], expected| {
        build(ThesisTable::Table31, rows, &coverage(expected)).unwrap_err()
    };
    assert!(matches!(
        refuse(&good, 2),
        TableError::Excess { found: 3, .. }
    ));

    let mut old = good.clone();
    for row in &mut old {
        row.context.protocol_digest = "0123456789abcdef".to_owned();
    }
    assert_eq!(
        refuse(&old, 200).to_string(),
        "the rows of model A were measured under another definition of kitti2015 (digest \
         0123456789ab; here it is a569e08a7e07), so measure again with this version"
    );

    let mut others = rows("B", "kitti2015", 3, 0.1);
    for row in &mut others {
        row.context.data_digest = "other".to_owned();
    }
    let error = refuse(&[good.clone(), others].concat(), 200);
    assert!(matches!(error, TableError::Data { .. }), "{error}");

    let error = refuse(&[good.clone(), good].concat(), 200);
    assert!(
        matches!(error, TableError::Rows(RowsError::Duplicate { .. })),
        "{error}"
    );
}

#[test]
fn names_of_tables() {
    for table in ThesisTable::ALL {
        assert_eq!(table.to_string().parse(), Ok(table));
    }
    assert!("3.4".parse::<ThesisTable>().is_err());
}
