//! NumPy's `.npy`: two-dimensional arrays of `f32` or `f64` in, `f32` out.
//!
//! The format is NumPy's (numpy.lib.format, versions 1 to 3). The header is believed only as far
//! as the bytes behind it go, so a damaged file costs no memory. Other types and ranks are
//! refused, not converted.

/// An array as read: width, height and values row by row.
pub type Array = (usize, usize, Vec<f64>);

/// First bytes of every file.
const MAGIC: &[u8] = b"\x93NUMPY";

/// Reads a two-dimensional array (rows, columns) of 32- or 64-bit floats of either byte order.
///
/// # Errors
/// It is no npy, cut off, or of another type or rank; the sentence says what was found.
pub fn decode(bytes: &[u8]) -> Result<Array, String> {
    let no_npy = || "it is no .npy file of NumPy".to_owned();
    let cut_off = || format!("it is cut off after {} bytes", bytes.len());
    let rest = bytes.strip_prefix(MAGIC).ok_or_else(no_npy)?;
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
    let (header, data) = rest.split_at_checked(length).ok_or_else(cut_off)?;
    let header = std::str::from_utf8(header).map_err(|_| no_npy())?;

    let value = |key: &str| -> Result<&str, String> {
        let (_, value) = header
            .split_once(&format!("'{key}'"))
            .ok_or_else(|| format!("its header has no `{key}`"))?;
        let value = value.trim_start().strip_prefix(':').ok_or_else(no_npy)?;
        Ok(value.trim_start())
    };
    let descr = value("descr")?
        .strip_prefix('\'')
        .and_then(|rest| rest.split_once('\''))
        .ok_or("its elements are structures, not 32- or 64-bit floats")?
        .0;
    let (size, big_endian) = match descr {
        "<f4" => (4, false),
        ">f4" => (4, true),
        "<f8" => (8, false),
        ">f8" => (8, true),
        other => {
            return Err(format!(
                "its type is `{other}`; it should hold 32- or 64-bit floats (`<f4`, `<f8`)"
            ));
        }
    };
    let by_column = value("fortran_order")?.starts_with("True");
    let shape = value("shape")?
        .strip_prefix('(')
        .and_then(|rest| rest.split_once(')'))
        .ok_or_else(no_npy)?
        .0;
    let sides: Vec<&str> = shape
        .split(',')
        .map(str::trim)
        .filter(|side| !side.is_empty())
        .collect();
    let &[height, width] = sides.as_slice() else {
        return Err(format!(
            "its shape is ({shape}); it should have two dimensions, rows and columns"
        ));
    };
    let side = |text: &str| {
        let side = text.parse::<usize>().ok();
        side.ok_or_else(|| format!("its shape ({shape}) is no pair of numbers"))
    };
    let (height, width) = (side(height)?, side(width)?);
    let expected = width
        .checked_mul(height)
        .and_then(|values| values.checked_mul(size));
    if expected != Some(data.len()) {
        return Err(format!(
            "its header promises {height} x {width} values of {size} bytes, but {} bytes follow",
            data.len()
        ));
    }
    let values = data.chunks_exact(size).map(|bytes| {
        let mut eight = [0; 8];
        eight[..size].copy_from_slice(bytes);
        if big_endian {
            eight[..size].reverse();
        }
        match size {
            4 => f64::from(f32::from_le_bytes([eight[0], eight[1], eight[2], eight[3]])),
            _ => f64::from_le_bytes(eight),
        }
    });
    let mut values: Vec<f64> = values.collect();
    if by_column {
        let columns = values;
        values = Vec::with_capacity(columns.len());
        for row in 0..height {
            values.extend((0..width).map(|column| columns[column * height + row]));
        }
    }
    Ok((width, height, values))
}

/// The bytes of a two-dimensional `f32` array (rows, columns), version 1.0 as NumPy writes it.
pub fn encode(width: usize, height: usize, values: &[f32]) -> Vec<u8> {
    let mut header =
        format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({height}, {width}), }}");
    // Magic, version, length and header together fill blocks of 64 bytes; a line feed ends them.
    let before = MAGIC.len() + 4;
    while !(before + header.len() + 1).is_multiple_of(64) {
        header.push(' ');
    }
    header.push('\n');
    let mut bytes = Vec::with_capacity(before + header.len() + 4 * values.len());
    bytes.extend_from_slice(MAGIC);
    bytes.extend_from_slice(&[1, 0]);
    let length = u16::try_from(header.len()).expect("two numbers make a short header");
    bytes.extend_from_slice(&length.to_le_bytes());
    bytes.extend_from_slice(header.as_bytes());
    bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
    bytes
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
        let (width, height, back) = decode(&bytes).unwrap();
        assert_eq!((width, height), (3, 2));
        assert!(back.iter().zip(values).all(|(a, b)| *a == f64::from(b)));
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
        assert_eq!(
            decode(&by_row).unwrap(),
            (3, 2, vec![1., 2., 3., 4., 5., 6.])
        );
        let by_column = npy(
            "{'descr': '>f8', 'fortran_order': True, 'shape': (2, 3), }",
            &big,
        );
        assert_eq!(
            decode(&by_column).unwrap(),
            (3, 2, vec![1., 3., 5., 2., 4., 6.])
        );
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
            (header("<f4", "(2,)"), "two dimensions"),
            (header("<f4", "(1, 2, 1)"), "two dimensions"),
            (
                header("<f4", "(1, 3)"),
                "promises 1 x 3 values of 4 bytes, but 8 bytes follow",
            ),
            (
                header("<f8", "(4611686018427387904, 8)"),
                "but 8 bytes follow",
            ),
            (header("<f4", "(a, 2)"), "no pair of numbers"),
            (npy("{'shape': (1, 2)}", &[]), "no `descr`"),
            (
                npy("{'descr': [('a', '<f4')], 'shape': (1, 2)}", &[]),
                "structures",
            ),
            (b"PNG".to_vec(), "no .npy file"),
            (encode(3, 2, &[0.0; 6])[..9].to_vec(), "cut off"),
        ] {
            let problem = decode(&bytes).unwrap_err();
            assert!(
                problem.contains(reason),
                "{problem} should contain {reason}"
            );
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
