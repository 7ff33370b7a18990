//! The list of a user's pairs: a CSV file with named columns.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Component, Path};

use strat_splits::Role;

use strat_store::set::check_id;

/// Needed where the list has a column `right`; a list of single images needs only the first.
const REQUIRED: [&str; 4] = ["left", "right", "focal_px", "baseline_m"];
const OPTIONAL: [&str; 7] = [
    "id",
    "split",
    "depth",
    "disparity",
    "depth_scale",
    "invalid",
    "disparity_offset_px",
];

/// Shares of the pairs that are drawn where the list does not say their role; the rest is for training.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shares {
    /// For validation.
    pub val: f64,
    /// For testing.
    pub test: f64,
}

impl Shares {
    /// The first eight bytes of the id's BLAKE3, little-endian, as a fraction of 2^64: the lowest
    /// are for testing, the next for validation, the rest for training.
    fn role(self, id: &str) -> Role {
        let hash = blake3::hash(id.as_bytes());
        let [a, b, c, d, e, f, g, h, ..] = *hash.as_bytes();
        let drawn = u64::from_le_bytes([a, b, c, d, e, f, g, h]) as f64 / 2.0_f64.powi(64);
        if drawn < self.test {
            Role::Test
        } else if drawn < self.test + self.val {
            Role::Val
        } else {
            Role::Train
        }
    }
}

/// A usable row.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    /// As written, or made of the path of the left image.
    pub id: String,
    /// As written, or drawn.
    pub role: Role,
    /// As written.
    pub left: String,
    /// As written; none of an image that stands alone.
    pub right: Option<String>,
    /// 0 where it is not known, which only an image that stands alone may leave open.
    pub focal_px: f64,
    /// 0 where it is not known, as the focal length.
    pub baseline_m: f64,
    /// None where no file is named.
    pub truth: Option<Truth>,
}

/// Ground truth of a row.
#[derive(Debug, Clone, PartialEq)]
pub struct Truth {
    /// As written.
    pub file: String,
    /// Disparity in pixels instead of depth in metres.
    pub is_disparity: bool,
    /// What the values in the file are divided by.
    pub scale: Option<f64>,
    /// The value in the file that stands for "not measured"; 0 where none is named.
    pub invalid: Option<f64>,
    /// Added to measured disparity: how much farther right the principal point of the right camera is.
    pub offset_px: f64,
}

/// A row that cannot be used.
#[derive(Debug, PartialEq)]
pub struct BadRow {
    /// Its line in the file, from 1.
    pub line: u64,
    /// As far as it is known, else empty.
    pub id: String,
    /// As far as it is known.
    pub role: Option<Role>,
    /// A sentence about what is wrong.
    pub problem: String,
}

/// The rows of a list.
#[derive(Debug, Default)]
pub struct Table {
    /// Those that can be used, in the order of the file, with ids that differ.
    pub rows: Vec<Row>,
    /// The others.
    pub bad: Vec<BadRow>,
}

/// Which column is where.
struct Columns(BTreeMap<&'static str, usize>);

impl Columns {
    fn parse(header: &csv::ByteRecord) -> Result<Self, String> {
        let mut columns = BTreeMap::new();
        for (at, name) in header.iter().enumerate() {
            let name = String::from_utf8_lossy(name);
            let known = REQUIRED
                .iter()
                .chain(&OPTIONAL)
                .find(|known| **known == name);
            let Some(known) = known else {
                return Err(format!(
                    "line 1: unknown column `{name}`; the columns are {} and, if wanted, {}, separated \
                     by commas",
                    REQUIRED.join(", "),
                    OPTIONAL.join(", ")
                ));
            };
            if columns.insert(*known, at).is_some() {
                return Err(format!("line 1: the column `{known}` occurs twice"));
            }
        }
        let is_of_pairs = columns.contains_key("right");
        for name in REQUIRED {
            if !columns.contains_key(name) && (is_of_pairs || name == "left") {
                return Err(format!(
                    "line 1: the column `{name}` is missing; {} are required, or `left` and ground truth \
                     alone where no image has a right one",
                    REQUIRED.join(", ")
                ));
            }
        }
        if columns.contains_key("depth") && columns.contains_key("disparity") {
            return Err(
                "line 1: there are a column `depth` and a column `disparity`; keep one".to_owned(),
            );
        }
        let has_truth = columns.contains_key("depth") || columns.contains_key("disparity");
        for name in ["depth_scale", "invalid"] {
            if columns.contains_key(name) && !has_truth {
                return Err(format!(
                    "line 1: the column `{name}` needs a column `depth` or `disparity`"
                ));
            }
        }
        if columns.contains_key("disparity_offset_px") && !columns.contains_key("disparity") {
            return Err(
                "line 1: the column `disparity_offset_px` needs a column `disparity`".to_owned(),
            );
        }
        Ok(Self(columns))
    }

    /// The text of a column, empty if the table has no such column.
    fn get<'a>(&self, fields: &[&'a str], name: &str) -> &'a str {
        let at = self.0.get(name);
        at.and_then(|at| fields.get(*at)).copied().unwrap_or("")
    }
}

/// Reads the list; roles that it leaves open are drawn by `shares`. A bad row is no error.
///
/// # Errors
/// The header lacks a column, has one that is not known, or the text is no CSV; with a sentence.
pub fn parse(bytes: &[u8], shares: Shares) -> Result<Table, String> {
    // Spreadsheets begin their files with a byte order mark.
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let mut reader = csv::ReaderBuilder::new()
        .trim(csv::Trim::All)
        .flexible(true)
        .from_reader(bytes);
    let header = reader.byte_headers().map_err(|e| e.to_string())?.clone();
    if header.iter().all(<[u8]>::is_empty) {
        return Err(format!(
            "it is empty; its first line should name the columns {}",
            REQUIRED.join(", ")
        ));
    }
    let columns = Columns::parse(&header)?;
    let mut table = Table::default();
    let mut seen = BTreeSet::new();
    for record in reader.byte_records() {
        let record = record.map_err(|e| e.to_string())?;
        let mut bad = BadRow {
            line: record.position().map_or(0, csv::Position::line),
            id: String::new(),
            role: None,
            problem: String::new(),
        };
        match parse_row(&record, header.len(), &columns, shares, &mut bad) {
            Ok(row) if seen.insert(row.id.clone()) => table.rows.push(row),
            Ok(row) => {
                bad.problem = format!("the id `{}` occurs twice", row.id);
                table.bad.push(bad);
            }
            Err(problem) => {
                bad.problem = problem;
                table.bad.push(bad);
            }
        }
    }
    Ok(table)
}

/// Reads a row; what is known of it is noted in `known` even if the rest is bad.
fn parse_row(
    record: &csv::ByteRecord,
    expected: usize,
    columns: &Columns,
    shares: Shares,
    known: &mut BadRow,
) -> Result<Row, String> {
    if record.len() != expected {
        return Err(format!(
            "it has {} fields, but there are {expected} columns",
            record.len()
        ));
    }
    let fields: Option<Vec<&str>> = record
        .iter()
        .map(|field| std::str::from_utf8(field).ok())
        .collect();
    let fields = fields.ok_or("it is not UTF-8 text; save the file as UTF-8")?;
    let text = |name: &str| columns.get(&fields, name);
    let number = |name: &str, what: &str, fits: fn(f64) -> bool| {
        let number = text(name).parse().ok();
        number.filter(|n| fits(*n)).ok_or_else(|| {
            let text = text(name);
            format!("`{name}` should be {what}, but is `{text}`")
        })
    };
    let positive = |name: &str| number(name, "a positive number", |n| n.is_finite() && n > 0.0);
    let right = text("right");
    let is_single = right.is_empty();
    // What an image that stands alone may leave open.
    let positive_or_unknown = |name: &str| match text(name) {
        "" if is_single => Ok(0.0),
        _ => positive(name),
    };
    let left = match text("left") {
        "" => return Err("`left` is empty".to_owned()),
        left => left.to_owned(),
    };
    let id = match text("id") {
        "" => id_of(&left),
        id => id.to_owned(),
    };
    check_id(&id)?;
    known.id.clone_from(&id);
    let role = match columns.0.contains_key("split") {
        true => {
            let role = Role::ALL
                .into_iter()
                .find(|role| role.as_str() == text("split"));
            role.ok_or_else(|| {
                format!(
                    "`split` should be train, val or test, but is `{}`",
                    text("split")
                )
            })?
        }
        false if is_single => Role::Test,
        false => shares.role(&id),
    };
    known.role = Some(role);
    let (focal_px, baseline_m) = (
        positive_or_unknown("focal_px")?,
        positive_or_unknown("baseline_m")?,
    );
    let is_disparity = columns.0.contains_key("disparity");
    let file = text(if is_disparity { "disparity" } else { "depth" });
    if is_single && role != Role::Test {
        return Err(format!(
            "`right` is empty, and an image without a right one can only be tested on; `split` is {role}"
        ));
    }
    if is_single && file.is_empty() {
        return Err(
            "`right` is empty, and so is the ground truth that the image could be tested with"
                .to_owned(),
        );
    }
    if is_single && is_disparity && (focal_px == 0.0 || baseline_m == 0.0) {
        return Err(
            "`disparity` becomes depth with `focal_px` and `baseline_m`, which are not both there"
                .to_owned(),
        );
    }
    let given = |name: &str| !text(name).is_empty();
    let scale = given("depth_scale").then(|| positive("depth_scale"));
    // Not a number is a usual way to say that nothing was measured, and is always that.
    let invalid = given("invalid").then(|| number("invalid", "a number", |_| true));
    let offset = given("disparity_offset_px")
        .then(|| number("disparity_offset_px", "a number of pixels", f64::is_finite));
    let truth = Truth {
        file: file.to_owned(),
        is_disparity,
        scale: scale.transpose()?,
        invalid: invalid.transpose()?,
        offset_px: offset.transpose()?.unwrap_or(0.0),
    };
    Ok(Row {
        right: (!is_single).then(|| right.to_owned()),
        focal_px,
        baseline_m,
        truth: (!file.is_empty()).then_some(truth),
        id,
        role,
        left,
    })
}

/// The path of an image without its extension and without what leads out of a folder.
fn id_of(left: &str) -> String {
    let path = Path::new(left).with_extension("");
    let parts = path.components().filter_map(|part| match part {
        Component::Normal(part) => part.to_str(),
        _ => None,
    });
    parts.collect::<Vec<_>>().join("/")
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const SHARES: Shares = Shares {
        val: 0.1,
        test: 0.1,
    };

    #[test]
    fn rows_are_read() {
        let text = "\u{feff}left, right,focal_px,baseline_m,split,disparity,depth_scale\n\
            l/Straße 1.png,r/1.png,721.5,0.54,test,d/1.png,100\n\
            ../l/2.jpg,r/2.jpg,1e3,12,train,,\n";
        let table = parse(text.as_bytes(), SHARES).unwrap();
        assert_eq!(table.bad, []);
        assert_eq!(
            table.rows[0],
            Row {
                id: "l/Straße 1".to_owned(),
                role: Role::Test,
                left: "l/Straße 1.png".to_owned(),
                right: Some("r/1.png".to_owned()),
                focal_px: 721.5,
                baseline_m: 0.54,
                truth: Some(Truth {
                    file: "d/1.png".to_owned(),
                    is_disparity: true,
                    scale: Some(100.0),
                    invalid: None,
                    offset_px: 0.0,
                }),
            }
        );
        assert_eq!((&*table.rows[1].id, &table.rows[1].truth), ("l/2", &None));
    }

    #[test]
    fn bad_headers_are_refused_by_name() {
        for (text, reason) in [
            ("", "it is empty"),
            ("left,right,focal_px\n", "`baseline_m` is missing"),
            (
                "left,right,focal_px,baseline_m,colour\n",
                "unknown column `colour`",
            ),
            ("left;right;focal_px;baseline_m\n", "separated by commas"),
            (
                "left,left,right,focal_px,baseline_m\n",
                "`left` occurs twice",
            ),
            (
                "left,right,focal_px,baseline_m,depth,disparity\n",
                "keep one",
            ),
            (
                "left,right,focal_px,baseline_m,depth_scale\n",
                "needs a column",
            ),
            ("left,invalid\n", "`invalid` needs a column"),
            (
                "left,depth,disparity_offset_px\n",
                "needs a column `disparity`",
            ),
            ("depth\n", "`left` is missing"),
        ] {
            let problem = parse(text.as_bytes(), SHARES).unwrap_err();
            assert!(
                problem.contains(reason),
                "{problem} should contain {reason}"
            );
        }
    }

    #[test]
    fn bad_rows_are_named_and_the_rest_stays() {
        let text = b"id,left,right,focal_px,baseline_m,split\n\
            a,l.png,r.png,wide,0.5,val\n\
            b,l.png,r.png,700,0.5,val\n\
            b,l.png,r.png,700,0.5,val\n\
            c,l.png,,700,0.5,val\n\
            d,l.png,r.png,700,-1,val\n\
            e,l.png,r.png,700,0.5,dev\n\
            ../f,l.png,r.png,700,0.5,val\n\
            g,l.png,r.png,700\n\
            \xff,l.png,r.png,700,0.5,val\n\
            h,l.png,r.png,NaN,0.5,train\n";
        let table = parse(text, SHARES).unwrap();
        assert_eq!(table.rows.len(), 1);
        let reasons = [
            (2, "`focal_px` should be a positive number, but is `wide`"),
            (4, "the id `b` occurs twice"),
            (5, "can only be tested on; `split` is val"),
            (6, "`baseline_m` should be"),
            (7, "`split` should be train, val or test, but is `dev`"),
            (8, "not a usable id"),
            (9, "4 fields, but there are 6 columns"),
            (10, "not UTF-8"),
            (11, "but is `NaN`"),
        ];
        assert_eq!(table.bad.len(), reasons.len());
        for (bad, (line, reason)) in table.bad.iter().zip(reasons) {
            assert_eq!(bad.line, line);
            assert!(bad.problem.contains(reason), "{}", bad.problem);
        }
        assert_eq!(
            (&*table.bad[0].id, table.bad[0].role),
            ("a", Some(Role::Val))
        );
    }

    #[test]
    fn images_without_a_right_one_are_tested_on() {
        let text = b"left,depth,depth_scale,invalid\n\
            rgb/1.png,d/1.png,1000,65535\n\
            rgb/2.png,,1000,\n";
        let table = parse(text, SHARES).unwrap();
        let row = &table.rows[0];
        assert_eq!((row.role, &row.right), (Role::Test, &None));
        assert_eq!((row.focal_px, row.baseline_m), (0.0, 0.0));
        let truth = row.truth.as_ref().unwrap();
        assert_eq!((truth.scale, truth.invalid), (Some(1000.0), Some(65535.0)));
        assert!(table.bad[0].problem.contains("so is the ground truth"));

        let text = b"left,right,focal_px,baseline_m,disparity,disparity_offset_px,split\n\
            a.png,b.png,3997.7,0.193,d.npy,131.111,test\n\
            c.png,,700,,d.npy,,test\n\
            d.png,,700,0.5,d.npy,-3,test\n\
            e.png,,700,0.5,d.npy,,train\n\
            f.png,,700,0.5,d.npy,much,test\n";
        let table = parse(text, SHARES).unwrap();
        let offset = |row: &Row| row.truth.as_ref().unwrap().offset_px;
        assert_eq!((table.rows.len(), offset(&table.rows[0])), (2, 131.111));
        assert_eq!(
            (offset(&table.rows[1]), &table.rows[1].right),
            (-3.0, &None)
        );
        for (bad, reason) in table.bad.iter().zip([
            "which are not both there",
            "`split` is train",
            "a number of pixels, but is `much`",
        ]) {
            assert!(bad.problem.contains(reason), "{}", bad.problem);
        }
    }

    #[test]
    fn roles_are_drawn_by_id_in_the_asked_shares() {
        let drawn = |shares: Shares, role| {
            (0..10_000)
                .filter(|i| shares.role(&format!("frame {i}")) == role)
                .count()
        };
        let shares = Shares {
            val: 0.2,
            test: 0.1,
        };
        // Three standard deviations of a binomial draw are 90 and 120.
        assert!((910..1090).contains(&drawn(shares, Role::Test)));
        assert!((1880..2120).contains(&drawn(shares, Role::Val)));
        assert_eq!(
            drawn(
                Shares {
                    val: 0.0,
                    test: 0.0
                },
                Role::Train
            ),
            10_000
        );
        assert_eq!(
            drawn(
                Shares {
                    val: 0.0,
                    test: 1.0
                },
                Role::Test
            ),
            10_000
        );
    }

    proptest! {
        #[test]
        fn no_bytes_make_the_list_panic(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
            let _ = parse(&bytes, SHARES);
            let header = b"left,right,focal_px,baseline_m,id,disparity,depth_scale\n";
            let _ = parse(&[&header[..], &bytes].concat(), SHARES);
        }

        #[test]
        fn no_row_makes_it_panic(rows in "([a-z./\\\\\" ]{0,6}[,\n]|[0-9e.]{1,4},){0,30}") {
            let text = format!("left,right,focal_px,baseline_m,id\n{rows}");
            let table = parse(text.as_bytes(), SHARES).unwrap();
            for row in table.rows {
                prop_assert!(check_id(&row.id).is_ok());
            }
        }
    }
}
