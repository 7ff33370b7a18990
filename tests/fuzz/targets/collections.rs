//! The list of a user's own pairs, and camera files of Cityscapes.
#![no_main]

mod damage;

use std::collections::BTreeSet;

use libfuzzer_sys::fuzz_target;
use strat_prep::collections::{
    cityscapes,
    pairs::{Shares, list},
};
use strat_store::set::check_id;

const LIST: &str = "\u{feff}id,left,right,focal_px,baseline_m,split,disparity,depth_scale,invalid,disparity_offset_px
a/1,l/1.png,r/1.png,721.5,0.54,test,d/1.png,256,0,
a/2,\"l/2, left.png\",r/2.png,1e3,0.12,train,,,,
,d.png,,700,0.5,test,d.npy,,nan,-3.5
";
const SINGLE: &str =
    "left,depth,depth_scale,invalid\nrgb/1.png,d/1.png,1000,65535\nrgb/2.png,d/2.exr,,\n";
const CAMERA: &str = r#"{"extrinsic": {"baseline": 0.209313, "pitch": 0.03},
    "intrinsic": {"fx": 2262.52, "fy": 2265.3, "u0": 1096.98, "v0": 513.137}}"#;

fuzz_target!(|data: &[u8]| {
    let Some((which, data)) = data.split_first() else {
        return;
    };
    let shares = Shares {
        val: 0.1,
        test: 0.1,
    };
    let list = match which % 3 {
        0 => LIST,
        1 => SINGLE,
        _ => {
            if let Ok((focal_px, baseline_m)) =
                cityscapes::parse_camera(&damage::damaged(CAMERA.as_bytes(), data))
            {
                assert!(focal_px.is_finite() && focal_px > 0.0);
                assert!(baseline_m.is_finite() && baseline_m > 0.0);
            }
            return;
        }
    };
    let Ok(table) = list::parse(&damage::damaged(list.as_bytes(), data), shares) else {
        return;
    };
    let mut ids = BTreeSet::new();
    for row in &table.rows {
        // Ids become paths of the set.
        assert!(check_id(&row.id).is_ok() && ids.insert(&row.id));
        assert!(row.focal_px.is_finite() && row.focal_px >= 0.0);
        assert!(row.baseline_m.is_finite() && row.baseline_m >= 0.0);
        assert!(row.right.is_some() || row.truth.is_some());
    }
    assert!(table.bad.iter().all(|bad| !bad.problem.is_empty()));
});
