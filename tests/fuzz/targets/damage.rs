//! Turns a fuzzer's bytes into damage to a valid file, so that checksums, headers and magic numbers
//! do not keep it from the depths of a parser.

/// The file to try: `valid` with bytes replaced, put in, cut out, or the data itself.
pub fn damaged(valid: &[u8], data: &[u8]) -> Vec<u8> {
    let Some((&kind, edits)) = data.split_first() else {
        return valid.to_vec();
    };
    if kind % 4 == 0 {
        return edits.to_vec();
    }
    let mut bytes = valid.to_vec();
    for edit in edits.chunks_exact(4) {
        let at = usize::from(u16::from_le_bytes([edit[0], edit[1]]));
        let at = at % bytes.len().max(1);
        match edit[2] % 8 {
            _ if bytes.is_empty() => bytes.push(edit[3]),
            0 => bytes.truncate(at),
            1 => bytes.insert(at, edit[3]),
            2 => drop(bytes.remove(at)),
            3 => bytes[at] ^= 1 << (edit[3] % 8),
            4 => {
                let end = (at + usize::from(edit[3])).min(bytes.len());
                let part = bytes[at..end].to_vec();
                bytes.splice(at..at, part);
            }
            _ => bytes[at] = edit[3],
        }
    }
    bytes
}
