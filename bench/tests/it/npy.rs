//! NumPy's files as the tests write and read them: 32-bit floats, version 1.0 of the format. Written apart
//! from the code under test, so that neither can hide a mistake of the other.

use std::{fs, path::Path};

/// Writes an array of this shape, its values row by row.
#[track_caller]
pub fn write(path: &Path, shape: &[usize], values: impl IntoIterator<Item = f32>) {
    let sides: String = shape.iter().map(|side| format!("{side}, ")).collect();
    let mut header = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({sides}), }}");
    // Magic, version, length and header together are a multiple of 64 bytes.
    while !(10 + header.len() + 1).is_multiple_of(64) {
        header.push(' ');
    }
    header.push('\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend(u16::try_from(header.len()).unwrap().to_le_bytes());
    bytes.extend(header.into_bytes());
    let before = bytes.len();
    bytes.extend(values.into_iter().flat_map(f32::to_le_bytes));
    assert_eq!(
        bytes.len() - before,
        4 * shape.iter().product::<usize>(),
        "{shape:?}"
    );
    fs::write(path, bytes).unwrap();
}

/// Reads an array: its shape and its values row by row.
#[track_caller]
pub fn read(path: &Path) -> (Vec<usize>, Vec<f32>) {
    let bytes = fs::read(path).unwrap();
    assert_eq!(&bytes[..8], b"\x93NUMPY\x01\x00", "{}", path.display());
    let start = 10 + usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
    let header = std::str::from_utf8(&bytes[10..start]).unwrap();
    assert!(header.contains("'descr': '<f4'"), "{header}");
    assert!(header.contains("'fortran_order': False"), "{header}");
    let (_, sides) = header.split_once("'shape': (").unwrap();
    let (sides, _) = sides.split_once(')').unwrap();
    let sides = sides
        .split(',')
        .map(str::trim)
        .filter(|side| !side.is_empty());
    let shape: Vec<usize> = sides.map(|side| side.parse().unwrap()).collect();
    let value = |bytes: &[u8]| f32::from_le_bytes(bytes.try_into().unwrap());
    let values: Vec<f32> = bytes[start..].chunks(4).map(value).collect();
    assert_eq!(values.len(), shape.iter().product::<usize>(), "{header}");
    (shape, values)
}
