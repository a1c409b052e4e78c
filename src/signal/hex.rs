/// Bytes in lower-case hexadecimal, as hashes are written.
pub fn hex(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 16] = b"0123456789abcdef";
    let digits = bytes.iter().flat_map(|b| [b >> 4, b & 15]);
    digits.map(|d| char::from(DIGITS[usize::from(d)])).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_digits_per_byte() {
        assert_eq!(hex(&[0, 9, 0x1f, 0xa0, 255]), "00091fa0ff");
        assert_eq!(hex(&[]), "");
    }
}
