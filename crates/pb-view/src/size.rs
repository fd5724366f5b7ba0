//! Sizes in bytes as people write them, and as they like to read them.

/// Parses `64MiB`, `1.5 GiB`, `512 KiB` or plain bytes.
pub fn parse_bytes(text: &str) -> Result<u64, String> {
    let text = text.trim();
    let split = text.find(|c: char| !(c.is_ascii_digit() || c == '.')).unwrap_or(text.len());
    let (number, unit) = (&text[..split], text[split..].trim());
    let factor = match unit.to_ascii_lowercase().as_str() {
        "" | "b" => 1.0,
        "kib" => 1024.0,
        "mib" => 1024.0 * 1024.0,
        "gib" => 1024.0 * 1024.0 * 1024.0,
        _ => return Err(format!("'{unit}' is no unit of size; write KiB, MiB or GiB")),
    };
    let value: f64 = number.parse().map_err(|_| format!("'{text}' is no size; write for example 512MiB"))?;
    let bytes = value * factor;
    if !(1.0..=1e18).contains(&bytes) {
        return Err(format!("'{text}' is out of range; write for example 512MiB"));
    }
    Ok(bytes as u64)
}

/// `1.2 MiB`.
pub fn show_bytes(bytes: u64) -> String {
    let mut value = bytes as f64;
    for unit in ["B", "KiB", "MiB"] {
        if value < 1024.0 {
            return if unit == "B" { format!("{bytes} B") } else { format!("{value:.1} {unit}") };
        }
        value /= 1024.0;
    }
    format!("{value:.2} GiB")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_read_with_binary_units() {
        assert_eq!(parse_bytes("64MiB"), Ok(64 << 20));
        assert_eq!(parse_bytes("1.5 gib"), Ok(3 << 29));
        assert_eq!(parse_bytes("512 KiB"), Ok(512 << 10));
        assert_eq!(parse_bytes("77"), Ok(77));
        for bad in ["", "MiB", "-1", "1 MB", "0", "1e9", "nan", "1..2KiB", "9999999999GiB"] {
            assert!(parse_bytes(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn sizes_are_shown_short() {
        assert_eq!([0, 2048, 5 << 19, 3 << 29].map(show_bytes), ["0 B", "2.0 KiB", "2.5 MiB", "1.50 GiB"]);
    }
}
