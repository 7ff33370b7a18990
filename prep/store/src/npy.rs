//! NumPy's `.npy`: one map of floats, or many of one size read one by one.
//!
//! The format is NumPy's (numpy.lib.format, versions 1 to 3): a magic, a length, a Python literal of
//! three keys, then the values. A header is believed only as far as the bytes behind it go, so a
//! damaged file costs no memory. Floats of 16, 32 and 64 bits and unsigned integers of 16 bits are
//! read, in either order of bytes and of dimensions; other types are refused and not converted, and
//! pickled objects are never looked into. Problems are sentences that do not name the file.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use exr::prelude::f16;

use crate::files::Unfinished;
use crate::inputs::MAX_PIXELS;
use crate::raster::{Plane, from_little_endian};

/// A map as read.
#[derive(Debug, Clone, PartialEq)]
pub struct Array {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Values row by row.
    pub values: Vec<f64>,
    /// They are 16-bit integers, which usually stand for something else.
    pub are_integers: bool,
}

/// Type of the values.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    F16,
    F32,
    F64,
    U16,
}

impl Kind {
    fn bytes(self) -> usize {
        match self {
            Self::F16 | Self::U16 => 2,
            Self::F32 => 4,
            Self::F64 => 8,
        }
    }
}

/// First bytes of every file.
const MAGIC: &[u8] = b"\x93NUMPY";

/// Longest header read; NumPy's own is below 200 bytes.
const LONGEST_HEADER: usize = 4096;

/// Most bytes before the values: magic, version, length and header.
const LONGEST_START: usize = LONGEST_HEADER + 12;

/// What is said before the values.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Header {
    kind: Kind,
    big_endian: bool,
    /// The first index varies fastest.
    fortran_order: bool,
    shape: Vec<usize>,
    /// Bytes before the values.
    start: usize,
}

impl Header {
    /// Reads the beginning of a file: [`LONGEST_START`] bytes, or all if there are fewer.
    fn parse(bytes: &[u8]) -> Result<Self, String> {
        let no_array = || "it is not a NumPy array (.npy)".to_owned();
        let cut_off = || format!("it is cut off after {} bytes", bytes.len());
        let rest = bytes.strip_prefix(MAGIC).ok_or_else(no_array)?;
        let (&[major, _minor], rest) = rest.split_first_chunk().ok_or_else(cut_off)?;
        let (length, rest) = match major {
            1 => {
                let (length, rest) = rest.split_first_chunk().ok_or_else(cut_off)?;
                (usize::from(u16::from_le_bytes(*length)), rest)
            }
            2 | 3 => {
                let (length, rest) = rest.split_first_chunk().ok_or_else(cut_off)?;
                (u32::from_le_bytes(*length) as usize, rest)
            }
            other => return Err(format!("its .npy version {other} is unknown")),
        };
        if length > LONGEST_HEADER {
            return Err(format!(
                "its header of {length} bytes is too long for an array of numbers"
            ));
        }
        let text = rest.get(..length).ok_or_else(cut_off)?;
        let text = std::str::from_utf8(text).map_err(|_| no_array())?;
        let value = |key: &str| {
            let (_, value) = text
                .split_once(&format!("'{key}'"))
                .ok_or_else(|| format!("its header has no `{key}`"))?;
            let value = value.trim_start().strip_prefix(':').ok_or_else(no_array)?;
            Ok::<_, String>(value.trim_start())
        };
        let descr = value("descr")?
            .strip_prefix('\'')
            .and_then(|rest| rest.split_once('\''))
            .ok_or("its elements are structures, not 32- or 64-bit floats")?
            .0;
        let big_endian = descr.starts_with('>');
        let kind = match descr.trim_start_matches(['<', '>']) {
            "f2" => Kind::F16,
            "f4" => Kind::F32,
            "f8" => Kind::F64,
            "u2" => Kind::U16,
            _ => {
                return Err(format!(
                    "its type is `{descr}`, not floats of 16, 32 or 64 bits or unsigned integers of 16; \
                     save it with np.save(FILE, array.astype('<f4'))"
                ));
            }
        };
        let shape = value("shape")?
            .strip_prefix('(')
            .and_then(|rest| rest.split_once(')'))
            .ok_or_else(no_array)?
            .0;
        let sides = shape
            .split(',')
            .map(str::trim)
            .filter(|side| !side.is_empty());
        let sides: Result<Vec<usize>, _> = sides.map(str::parse).collect();
        Ok(Self {
            kind,
            big_endian,
            fortran_order: value("fortran_order")?.starts_with("True"),
            shape: sides
                .map_err(|_| format!("the shape ({shape}) in its header is not a list of sizes"))?,
            start: bytes.len() - rest.len() + length,
        })
    }

    /// Bytes of the values of these dimensions, if that is a number.
    fn size(&self, dimensions: &[usize]) -> Option<usize> {
        let mut dimensions = dimensions.iter();
        dimensions.try_fold(self.kind.bytes(), |size, side| size.checked_mul(*side))
    }

    fn values(&self, bytes: &[u8]) -> Vec<f64> {
        match (self.kind, self.big_endian) {
            (Kind::F16, false) => numbers(bytes, |b| f16::from_le_bytes(b).to_f64()),
            (Kind::F16, true) => numbers(bytes, |b| f16::from_be_bytes(b).to_f64()),
            (Kind::F32, false) => numbers(bytes, |b| f64::from(f32::from_le_bytes(b))),
            (Kind::F32, true) => numbers(bytes, |b| f64::from(f32::from_be_bytes(b))),
            (Kind::F64, false) => numbers(bytes, f64::from_le_bytes),
            (Kind::F64, true) => numbers(bytes, f64::from_be_bytes),
            (Kind::U16, false) => numbers(bytes, |b| f64::from(u16::from_le_bytes(b))),
            (Kind::U16, true) => numbers(bytes, |b| f64::from(u16::from_be_bytes(b))),
        }
    }

    fn values_f32(&self, bytes: &[u8]) -> Vec<f32> {
        match (self.kind, self.big_endian) {
            // What nearly all files have, without a step between.
            (Kind::F32, false) => numbers(bytes, f32::from_le_bytes),
            _ => self.values(bytes).into_iter().map(|v| v as f32).collect(),
        }
    }
}

fn numbers<const N: usize, T>(bytes: &[u8], number: impl Fn([u8; N]) -> T) -> Vec<T> {
    bytes.as_chunks().0.iter().map(|b| number(*b)).collect()
}

/// Reads a single map (rows, columns), also with a last dimension of 1, in either order of bytes and
/// of dimensions.
///
/// # Errors
/// It is no npy, cut off, or of another type or rank; the sentence says what was found.
pub fn decode(bytes: &[u8]) -> Result<Array, String> {
    let header = Header::parse(bytes)?;
    let &([height, width] | [height, width, 1]) = header.shape.as_slice() else {
        return Err(format!(
            "its shape is {:?}; it should have two dimensions, rows and columns",
            header.shape
        ));
    };
    let data = &bytes[header.start..];
    if header.size(&header.shape) != Some(data.len()) {
        return Err(format!(
            "its header promises {height} x {width} values of {} bytes, but {} bytes follow",
            header.kind.bytes(),
            data.len()
        ));
    }
    let mut values = header.values(data);
    if header.fortran_order {
        let columns = values;
        values = Vec::with_capacity(columns.len());
        for row in 0..height {
            values.extend((0..width).map(|column| columns[column * height + row]));
        }
    }
    Ok(Array {
        width,
        height,
        values,
        are_integers: header.kind == Kind::U16,
    })
}

/// Maps of one size in an array of shape `N x H x W`, `N x 1 x H x W` or `N x H x W x 1`, or the
/// single one of an array `H x W`. They are read one by one, so memory stays flat; only an array in
/// Fortran order, which has the values of a map far apart, is held as a whole.
#[derive(Debug)]
pub struct Planes {
    file: File,
    header: Header,
    /// The values of an array in Fortran order.
    fortran: Option<Vec<u8>>,
    /// They are 16-bit integers, which usually stand for something else.
    pub are_integers: bool,
    /// How many.
    pub count: usize,
    /// Columns of each.
    pub width: usize,
    /// Rows of each.
    pub height: usize,
}

impl Planes {
    /// Takes a file and holds its length against its header.
    ///
    /// # Errors
    /// No NumPy array, another type, order or shape, or a file that was cut short.
    pub fn new(mut file: File) -> Result<Self, String> {
        let io = |error: std::io::Error| error.to_string();
        let length = file.metadata().map_err(io)?.len();
        let mut start = Vec::new();
        file.seek(SeekFrom::Start(0)).map_err(io)?;
        (&mut file)
            .take(LONGEST_START as u64)
            .read_to_end(&mut start)
            .map_err(io)?;
        let header = Header::parse(&start)?;
        let shape = &header.shape;
        let (count, height, width) = match *shape.as_slice() {
            [n, h, w] | [n, 1, h, w] | [n, h, w, 1] => (n, h, w),
            [h, w] => (1, h, w),
            _ => {
                return Err(format!(
                    "its shape is {shape:?}; [images, height, width] is needed"
                ));
            }
        };
        if !matches!(header.size(&[height, width]), Some(1..=LARGEST_PLANE)) {
            return Err(format!("its shape is {shape:?}, which no predictions have"));
        }
        let needed = header.size(shape).and_then(|n| n.checked_add(header.start));
        if needed.map(|bytes| bytes as u64) != Some(length) {
            return Err(format!(
                "its header speaks of {count} maps of {width}x{height}, but it has {length} bytes; it is \
                 incomplete or damaged"
            ));
        }
        let fortran = match header.fortran_order {
            true if length > LARGEST_AT_ONCE => {
                return Err(format!(
                    "it is in Fortran order and has {length} bytes; above {LARGEST_AT_ONCE}, save it with \
                     np.ascontiguousarray, so that its maps can be read one by one"
                ));
            }
            true => {
                let mut values = Vec::new();
                file.seek(SeekFrom::Start(header.start as u64))
                    .and_then(|_| file.read_to_end(&mut values))
                    .map_err(io)?;
                Some(values)
            }
            false => None,
        };
        Ok(Self {
            file,
            are_integers: header.kind == Kind::U16,
            header,
            fortran,
            count,
            width,
            height,
        })
    }

    /// Reads a map, row by row.
    ///
    /// # Errors
    /// `index` is beyond the array, or the system refuses.
    pub fn plane(&mut self, index: usize) -> Result<Vec<f32>, String> {
        if index >= self.count {
            return Err(format!(
                "it has {} maps, counted from 0, so index {index} does not exist",
                self.count
            ));
        }
        // Neither can overflow: `new` has held the size of all planes against the file.
        let bytes = self.header.kind.bytes();
        if let Some(values) = &self.fortran {
            // The first index varies fastest, then the row, then the column.
            let pixels = (0..self.height).flat_map(|row| (0..self.width).map(move |at| (row, at)));
            let first = |(row, column)| index + self.count * (row + self.height * column);
            let plane = pixels
                .map(first)
                .flat_map(|at| &values[at * bytes..(at + 1) * bytes]);
            return Ok(self.header.values_f32(&plane.copied().collect::<Vec<u8>>()));
        }
        let size = self.height * self.width * bytes;
        let place = (self.header.start + index * size) as u64;
        let mut read = |bytes: &mut [u8]| {
            let found = self.file.seek(SeekFrom::Start(place));
            let read = found.and_then(|_| self.file.read_exact(bytes));
            read.map_err(|error| error.to_string())
        };
        if let (Kind::F32, false) = (self.header.kind, self.header.big_endian) {
            // What nearly all files have, without a step between.
            let mut values = vec![0.0_f32; self.height * self.width];
            read(bytemuck::cast_slice_mut(&mut values))?;
            from_little_endian(&mut values);
            return Ok(values);
        }
        let mut bytes = vec![0; size];
        read(&mut bytes)?;
        Ok(self.header.values_f32(&bytes))
    }
}

/// Bytes of a plane above which a header is not believed.
const LARGEST_PLANE: usize = 8 * MAX_PIXELS as usize;

/// Bytes of an array that is held as a whole.
const LARGEST_AT_ONCE: u64 = 4_000_000_000;

/// Bytes before the values in the files written here. As NumPy's own, a multiple of 64.
const HEADER_BYTES: usize = 128;

/// What is written before little-endian `f32` values of a shape, version 1.0 as NumPy writes it.
fn header(shape: &[usize]) -> Vec<u8> {
    let sides: Vec<_> = shape.iter().map(usize::to_string).collect();
    let mut text = format!(
        "{{'descr': '<f4', 'fortran_order': False, 'shape': ({}), }}",
        sides.join(", ")
    );
    // Magic, version, length and text fill the header together; a line feed ends them.
    let before = MAGIC.len() + 4;
    let padding = (HEADER_BYTES - before - 1).saturating_sub(text.len());
    text.extend(std::iter::repeat_n(' ', padding));
    text.push('\n');
    let length = u16::try_from(text.len()).expect("a few numbers make a short header");
    [MAGIC, &[1, 0], &length.to_le_bytes(), text.as_bytes()].concat()
}

/// The bytes of a two-dimensional `f32` array (rows, columns).
pub fn encode(width: usize, height: usize, values: &[f32]) -> Vec<u8> {
    let mut bytes = header(&[height, width]);
    bytes.reserve_exact(4 * values.len());
    bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
    bytes
}

/// Writes maps of one size into an array `N x H x W` of `f32`, one by one, so memory stays flat. The
/// file appears when it is finished, or not at all.
#[derive(Debug)]
pub struct PlaneWriter {
    file: Unfinished,
    path: PathBuf,
    /// Width and height of the first plane.
    size: Option<(usize, usize)>,
    count: usize,
}

impl PlaneWriter {
    /// Begins a file; its folder is made if there is none.
    ///
    /// # Errors
    /// The folder cannot be written to.
    pub fn create(path: &Path) -> crate::Result<Self> {
        let mut file = Unfinished::create(path)?;
        // Filled in at the end, when the number of planes is known.
        let begun = file.out.write_all(&[0; HEADER_BYTES]);
        begun.map_err(|e| crate::Error::io("write", path, e))?;
        Ok(Self {
            file,
            path: path.to_owned(),
            size: None,
            count: 0,
        })
    }

    /// Width and height of the planes, once there is one.
    pub fn size(&self) -> Option<(usize, usize)> {
        self.size
    }

    /// Adds a plane.
    ///
    /// # Errors
    /// The system refuses, e.g. because the disk is full.
    ///
    /// # Panics
    /// The plane has another size than the first: see [`PlaneWriter::size`].
    pub fn push(&mut self, plane: &Plane) -> crate::Result<()> {
        let size = (plane.width, plane.height);
        let first = *self.size.get_or_insert(size);
        assert_eq!(size, first, "the planes of an array have one size");
        for value in &plane.data {
            let written = self.file.out.write_all(&value.to_le_bytes());
            written.map_err(|e| crate::Error::io("write", &self.path, e))?;
        }
        self.count += 1;
        Ok(())
    }

    /// Completes the file.
    ///
    /// # Errors
    /// The system refuses.
    pub fn finish(mut self) -> crate::Result<()> {
        let (width, height) = self.size.unwrap_or_default();
        let header = header(&[self.count, height, width]);
        let out = &mut self.file.out;
        let written = out.rewind().and_then(|()| out.write_all(&header));
        written.map_err(|e| crate::Error::io("write", &self.path, e))?;
        self.file.finish()
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn npy(header: &str, data: &[u8]) -> Vec<u8> {
        let mut bytes = [MAGIC, &[1, 0]].concat();
        bytes.extend_from_slice(&u16::try_from(header.len()).unwrap().to_le_bytes());
        [&bytes, header.as_bytes(), data].concat()
    }

    #[test]
    fn arrays_come_back() {
        let values = [0.0, 1.5, -2.25, 1e-3, 80.0, f32::INFINITY];
        let bytes = encode(3, 2, &values);
        assert_eq!(
            bytes.len() % 64,
            24,
            "the header ends on a block of 64 bytes"
        );
        let back = decode(&bytes).unwrap();
        assert_eq!((back.width, back.height), (3, 2));
        assert!(
            back.values
                .iter()
                .zip(values)
                .all(|(a, b)| *a == f64::from(b))
        );
    }

    #[test]
    fn types_and_orders_are_understood() {
        let big: Vec<u8> = [1.0f64, 2.0, 3.0, 4.0, 5.0, 6.0]
            .iter()
            .flat_map(|v| v.to_be_bytes())
            .collect();
        let by_row = npy(
            "{'descr': '>f8', 'fortran_order': False, 'shape': (2, 3), }",
            &big,
        );
        let array = |values: Vec<f64>, are_integers| Array {
            width: 3,
            height: 2,
            values,
            are_integers,
        };
        let rows = vec![1., 2., 3., 4., 5., 6.];
        assert_eq!(decode(&by_row).unwrap(), array(rows, false));
        let by_column = npy(
            "{'descr': '>f8', 'fortran_order': True, 'shape': (2, 3), }",
            &big,
        );
        let rows = vec![1., 3., 5., 2., 4., 6.];
        assert_eq!(decode(&by_column).unwrap(), array(rows, false));
        // IEEE 754 halves: 1.5, -2.25, the largest, 0.1 as near as it gets, infinity, the smallest.
        let halves = [0x3e00_u16, 0xc080, 0x7bff, 0x2e66, 0x7c00, 0x0001];
        let numbers = [
            1.5,
            -2.25,
            65_504.0,
            0.099_975_585_937_5,
            f64::INFINITY,
            2.0_f64.powi(-24),
        ];
        let text = "{'descr': '<f2', 'fortran_order': False, 'shape': (2, 3), }";
        let little = halves.map(u16::to_le_bytes).concat();
        assert_eq!(
            decode(&npy(text, &little)).unwrap(),
            array(numbers.into(), false)
        );
        let shorts = [0, 1, 256, 65_535, 20_480, 7_u16];
        let text = "{'descr': '>u2', 'fortran_order': False, 'shape': (2, 3), }";
        let big = shorts.map(u16::to_be_bytes).concat();
        assert_eq!(
            decode(&npy(text, &big)).unwrap(),
            array(shorts.map(f64::from).into(), true)
        );
    }

    #[test]
    fn planes_in_fortran_order_are_those_in_c_order() {
        // Recipe: np.asfortranarray(np.arange(12).reshape(2, 2, 3).astype(TYPE)).ravel('K'): the first
        // index, which map, varies fastest, then the row, then the column.
        let order = [0, 6, 3, 9, 1, 7, 4, 10, 2, 8, 5, 11_u8];
        let floats: Vec<u8> = order
            .iter()
            .flat_map(|v| f32::from(*v).to_le_bytes())
            .collect();
        let shorts: Vec<u8> = order
            .iter()
            .flat_map(|v| u16::from(*v).to_le_bytes())
            .collect();
        for (descr, values) in [("<f4", floats), ("<u2", shorts)] {
            for shape in ["(2, 2, 3)", "(2, 1, 2, 3)", "(2, 2, 3, 1)"] {
                let text = f4(shape).replace("<f4", descr).replace("False", "True");
                let mut planes = Planes::new(file(&npy(&text, &values))).unwrap();
                assert_eq!((planes.count, planes.width, planes.height), (2, 3, 2));
                assert_eq!(planes.are_integers, descr == "<u2");
                assert_eq!(planes.plane(0).unwrap(), [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]);
                assert_eq!(planes.plane(1).unwrap(), [6.0, 7.0, 8.0, 9.0, 10.0, 11.0]);
            }
        }
        let one: Vec<u8> = [0, 3, 1, 4, 2, 5_u8]
            .iter()
            .flat_map(|v| f32::from(*v).to_le_bytes())
            .collect();
        let text = f4("(2, 3)").replace("False", "True");
        let mut planes = Planes::new(file(&npy(&text, &one))).unwrap();
        assert_eq!(planes.plane(0).unwrap(), [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]);
    }

    #[test]
    fn other_arrays_are_refused_with_a_reason() {
        let header = |descr: &str, shape: &str| {
            npy(
                &format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}"),
                &[0; 8],
            )
        };
        for (bytes, reason) in [
            (header("<i4", "(1, 2)"), "its type is `<i4`"),
            (header("|u1", "(1, 8)"), "its type is `|u1`"),
            (header("<f4", "(2,)"), "two dimensions"),
            (header("<f4", "(1, 1, 2)"), "two dimensions"),
            (
                header("<f4", "(1, 3)"),
                "promises 1 x 3 values of 4 bytes, but 8 bytes follow",
            ),
            (
                header("<f8", "(4611686018427387904, 8)"),
                "but 8 bytes follow",
            ),
            (header("<f4", "(a, 2)"), "not a list of sizes"),
            (npy("{'shape': (1, 2)}", &[]), "no `descr`"),
            (
                npy("{'descr': [('a', '<f4')], 'shape': (1, 2)}", &[]),
                "structures",
            ),
            (b"PNG".to_vec(), "not a NumPy array (.npy)"),
            (encode(3, 2, &[0.0; 6])[..9].to_vec(), "cut off"),
        ] {
            let problem = decode(&bytes).unwrap_err();
            assert!(
                problem.contains(reason),
                "{problem} should contain {reason}"
            );
        }
    }

    fn file(bytes: &[u8]) -> File {
        let mut file = tempfile::tempfile().unwrap();
        file.write_all(bytes).unwrap();
        file
    }

    fn f4(shape: &str) -> String {
        format!("{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}\n")
    }

    #[test]
    fn planes_come_in_order() {
        let values: Vec<u8> = (0..12_u8)
            .flat_map(|v| f32::from(v).to_le_bytes())
            .collect();
        for shape in ["(2, 2, 3)", "(2, 1, 2, 3)", "(2, 2, 3, 1)"] {
            let mut planes = Planes::new(file(&npy(&f4(shape), &values))).unwrap();
            assert_eq!((planes.count, planes.width, planes.height), (2, 3, 2));
            assert_eq!(planes.plane(1).unwrap(), [6.0, 7.0, 8.0, 9.0, 10.0, 11.0]);
            assert_eq!(planes.plane(0).unwrap()[5], 5.0);
            assert!(planes.plane(2).is_err());
        }
        let mut one = Planes::new(file(&npy(&f4("(3, 4)"), &values))).unwrap();
        assert_eq!(one.plane(0).unwrap().len(), 12);
        let doubles = [0.5_f64, 2.0].map(f64::to_be_bytes).concat();
        let text = f4("(1, 1, 2)").replace("<f4", ">f8");
        let mut planes = Planes::new(file(&npy(&text, &doubles))).unwrap();
        assert_eq!(planes.plane(0).unwrap(), [0.5, 2.0]);
    }

    #[test]
    fn planes_are_written_one_by_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("new/planes.npy");
        let plane = |first: u8| Plane {
            width: 3,
            height: 2,
            data: (first..first + 6).map(f32::from).collect(),
        };
        let mut writer = PlaneWriter::create(&path).unwrap();
        assert_eq!(writer.size(), None);
        writer.push(&plane(0)).unwrap();
        writer.push(&plane(6)).unwrap();
        assert_eq!(writer.size(), Some((3, 2)));
        assert!(!path.exists(), "it is not finished");
        writer.finish().unwrap();
        // Recipe: np.save(FILE, np.arange(12, dtype='<f4').reshape(2, 2, 3)), NumPy 2.
        let text = "{'descr': '<f4', 'fortran_order': False, 'shape': (2, 2, 3), }";
        let values: Vec<u8> = (0..12_u8)
            .flat_map(|v| f32::from(v).to_le_bytes())
            .collect();
        let expected = [&npy(&format!("{text:117}\n"), &[]), &*values].concat();
        assert_eq!(std::fs::read(&path).unwrap(), expected);
        let mut back = Planes::new(File::open(&path).unwrap()).unwrap();
        assert_eq!(back.plane(1).unwrap(), plane(6).data);

        let mut given_up = PlaneWriter::create(&folder.path().join("new/other.npy")).unwrap();
        given_up.push(&plane(0)).unwrap();
        drop(given_up);
        assert_eq!(
            std::fs::read_dir(folder.path().join("new"))
                .unwrap()
                .count(),
            1
        );
    }

    #[test]
    fn arrays_that_are_no_maps_are_refused_with_a_reason() {
        for (text, wanted) in [
            (f4("(2,)"), "shape is [2]"),
            (f4("(2, 2, 3)"), "incomplete"),
            (f4("(2, 18446744073709551615, 3)"), "no predictions"),
            (f4("(18446744073709551615, 1, 1)"), "incomplete"),
            (f4("(2, 0, 3)"), "no predictions"),
            (f4("(2, x, 3)"), "not a list of sizes"),
            (f4("(2, 2, 3)").replace("<f4", "|O"), "its type is `|O`"),
            ("((((((((".repeat(400), "no `descr`"),
            (" ".repeat(5000), "too long"),
        ] {
            let error = Planes::new(file(&npy(&text, &[0; 47]))).unwrap_err();
            assert!(error.contains(wanted), "{error}");
        }
    }

    #[test]
    fn no_part_of_a_file_is_taken_for_the_whole() {
        let whole = npy(&f4("(1, 1, 1)"), &[0; 4]);
        assert!(Planes::new(file(&whole)).is_ok());
        for end in 0..whole.len() {
            assert!(Planes::new(file(&whole[..end])).is_err(), "{end} bytes");
        }
    }

    proptest! {
        #[test]
        fn no_bytes_make_it_panic(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
            let _ = decode(&bytes);
            let _ = decode(&[&encode(2, 2, &[0.0; 4])[..10], &bytes].concat());
        }

        #[test]
        fn no_header_makes_it_panic(header in "\\{?('descr'|'shape'|'fortran_order'|:|,| |\\(|\\)|[0-9]{1,20}|'<f4'|'>f8'){0,14}\\}?") {
            let _ = decode(&npy(&header, &[0; 16]));
        }
    }
}
