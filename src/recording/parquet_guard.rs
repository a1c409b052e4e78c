//! Parquet files before they are decoded: what they state is held against what they are.
//!
//! The decoder reserves memory for whatever lengths a file states: of the lists in its description, of its pages after
//! decompression, of its dictionaries. A file of a few kilobytes can state, and even hold, gigabytes. Therefore the
//! description and the head of every page that will be decoded are read here first.
//!
//! Both are structures of the Thrift compact protocol (Apache Thrift, "Thrift compact protocol"; Apache Parquet,
//! `parquet.thrift`, `PageHeader`).

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

use parquet::arrow::ProjectionMask;
use parquet::arrow::arrow_reader::{ArrowReaderOptions, ParquetRecordBatchReaderBuilder};
use parquet::basic::Type;

use super::RecordingError;
use super::error::refuse;
use super::size_limit::SizeLimit;

/// What a description may take in memory, per byte in the file.
const UNPACKED: u64 = 64;
/// Longest head of a page that is read, bytes: statistics of a page of numbers take some dozens.
const HEAD_MAX: usize = 4 << 10;
/// Deepest structure of a description.
const DEPTH_MAX: usize = 16;

/// What is read of a file, and the most it may take.
pub(super) struct Wanted<'a> {
    /// Names of the columns; those that are missing are left out.
    pub(super) columns: &'a [&'a str],
    /// Rows that are decoded at a time.
    pub(super) batch_rows: usize,
    /// Memory that one row takes in the end, bytes.
    pub(super) row_bytes: usize,
    /// The most that all may take.
    pub(super) limit: SizeLimit,
}

/// Rows that a vector reserves for one that it holds, at most.
const GROWTH: u64 = 2;

/// A decoder of the columns that are wanted, and the rows that the file states.
pub(super) fn open(
    path: &Path,
    mut file: File,
    wanted: &Wanted<'_>,
) -> Result<(ParquetRecordBatchReaderBuilder<File>, u64), RecordingError> {
    check_description(path, &mut file, wanted.limit)?;
    let damaged = |e: &dyn std::fmt::Display| {
        let e = e.to_string().replace('\n', " ");
        refuse(
            path,
            format!("the file is damaged or no Parquet file ({e}): make it again"),
        )
    };
    // Only numbers are read, and those need no description of Arrow's own.
    let options = ArrowReaderOptions::new().with_skip_arrow_metadata(true);
    let again = file.try_clone().map_err(RecordingError::io(path, "read"))?;
    let builder = ParquetRecordBatchReaderBuilder::try_new_with_options(again, options)
        .map_err(|e| damaged(&e))?;
    let metadata = builder.metadata().clone();
    let stated: Vec<i64> = metadata.row_groups().iter().map(|g| g.num_rows()).collect();
    let rows = stated.iter().try_fold(0_u64, |sum, rows| {
        sum.checked_add(u64::try_from(*rows).ok()?)
    });
    let rows = rows.ok_or_else(|| damaged(&"it states impossible numbers of rows"))?;
    let each = GROWTH * wanted.row_bytes as u64;
    wanted.limit.check_count(path, rows, "rows", each)?;
    let schema = builder.parquet_schema();
    let chosen: Vec<usize> = (0..schema.num_columns())
        .filter(|i| {
            let column = schema.column(*i);
            let number = !matches!(
                column.physical_type(),
                Type::BYTE_ARRAY | Type::FIXED_LEN_BYTE_ARRAY | Type::INT96
            );
            // One value per row: a list could hold any number of them.
            let plain = column.max_rep_level() == 0 && column.path().parts().len() == 1;
            number && plain && wanted.columns.contains(&column.name())
        })
        .collect();
    let mut pages = 0_u64;
    for group in metadata.row_groups() {
        let mut in_group = 0_u64;
        for i in &chosen {
            let column = group.columns().get(*i);
            let column = column.ok_or_else(|| damaged(&"a group of rows lacks a column"))?;
            let start = column.dictionary_page_offset();
            let start = start.unwrap_or(column.data_page_offset());
            let place = (start, column.compressed_size());
            let largest = largest_pages(&mut file, place).map_err(|e| damaged(&e))?;
            in_group = in_group.saturating_add(largest);
        }
        pages = pages.max(in_group);
    }
    wanted.limit.check(path, pages)?;
    let mask = ProjectionMask::leaves(schema, chosen);
    let builder = builder
        .with_projection(mask)
        .with_batch_size(wanted.batch_rows);
    Ok((builder, rows))
}

/// Refuses a description that is no structure, or states lists that are longer than itself.
fn check_description(path: &Path, file: &mut File, limit: SizeLimit) -> Result<(), RecordingError> {
    let io = |what: &'static str| RecordingError::io(path, what);
    let damaged = |what: &str| {
        refuse(
            path,
            format!("the file is damaged or no Parquet file ({what}): make it again"),
        )
    };
    let length = file.seek(SeekFrom::End(0)).map_err(io("read"))?;
    let mut end = [0; 8];
    if length < 12 {
        return Err(damaged("it is too short"));
    }
    file.seek(SeekFrom::Start(length - 8)).map_err(io("read"))?;
    file.read_exact(&mut end).map_err(io("read"))?;
    let [a, b, c, d, magic @ ..] = end;
    if magic != *b"PAR1" {
        return Err(damaged("it does not end as one"));
    }
    let description = u64::from(u32::from_le_bytes([a, b, c, d]));
    if description > length - 12 {
        return Err(damaged("its description is longer than the file"));
    }
    limit.check(path, description.saturating_mul(UNPACKED))?;
    file.seek(SeekFrom::Start(length - 8 - description))
        .map_err(io("read"))?;
    let mut bytes = vec![0; description as usize];
    file.read_exact(&mut bytes).map_err(io("read"))?;
    file.rewind().map_err(io("read"))?;
    Walk::new(&bytes)
        .structure(&mut |_, _| {})
        .ok_or_else(|| damaged("its description is no structure"))
}

/// Memory that the pages of a column take at most at one time: the largest of its pages and its dictionary.
/// `place` is where the column begins and how long it is, bytes.
fn largest_pages(file: &mut File, place: (i64, i64)) -> Result<u64, String> {
    let wrong = |what: &str| format!("a page {what}");
    let (Ok(start), Ok(length)) = (u64::try_from(place.0), u64::try_from(place.1)) else {
        return Err(wrong("is nowhere"));
    };
    let end_of_file = file.seek(SeekFrom::End(0)).map_err(|e| e.to_string())?;
    let end = start.checked_add(length).filter(|end| *end <= end_of_file);
    let end = end.ok_or_else(|| wrong("is beyond the end of the file"))?;
    let (mut at, mut page, mut dictionary) = (start, 0_u64, 0_u64);
    let mut bytes = Vec::with_capacity(HEAD_MAX);
    while at < end {
        bytes.clear();
        file.seek(SeekFrom::Start(at)).map_err(|e| e.to_string())?;
        let most = (end - at).min(HEAD_MAX as u64);
        file.take(most)
            .read_to_end(&mut bytes)
            .map_err(|e| e.to_string())?;
        let head = PageHead::read(&bytes).ok_or_else(|| wrong("has a damaged head"))?;
        let after = at + head.length as u64;
        let next = after
            .checked_add(head.compressed)
            .filter(|next| *next <= end);
        at = next.ok_or_else(|| wrong("is longer than its column"))?;
        // Every value takes a byte before it is compressed, but for bits and runs of indices.
        match head.dictionary_values {
            None => page = page.max(head.uncompressed),
            Some(values) if values > head.uncompressed => {
                return Err(wrong("states more values than it holds"));
            }
            // As values of eight bytes at most, beside the page itself.
            Some(_) => dictionary = dictionary.max(head.uncompressed.saturating_mul(9)),
        }
    }
    Ok(page.saturating_add(dictionary))
}

/// Head of a page.
#[derive(Debug, Default, PartialEq)]
struct PageHead {
    /// Its own length, bytes.
    length: usize,
    uncompressed: u64,
    compressed: u64,
    /// Number of values, if the page is a dictionary.
    dictionary_values: Option<u64>,
}

impl PageHead {
    fn read(bytes: &[u8]) -> Option<Self> {
        let mut walk = Walk::new(bytes);
        let (mut head, mut sound) = (Self::default(), true);
        walk.structure(&mut |path, value| {
            let mut take = || {
                sound &= value >= 0;
                u64::try_from(value).unwrap_or(0)
            };
            match path {
                [2] => head.uncompressed = take(),
                [3] => head.compressed = take(),
                [7, 1] => head.dictionary_values = Some(take()),
                _ => {}
            }
        })?;
        head.length = walk.at;
        sound.then_some(head)
    }
}

/// A walk through a structure of the compact protocol. `None` where the bytes are none.
struct Walk<'a> {
    bytes: &'a [u8],
    at: usize,
}

/// Called with the numbers of the fields that lead to an integer, and the integer.
type Visit<'v> = &'v mut dyn FnMut(&[i16], i64);

impl<'a> Walk<'a> {
    fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, at: 0 }
    }

    fn structure(&mut self, visit: Visit<'_>) -> Option<()> {
        self.fields(&mut Vec::new(), visit)
    }

    fn byte(&mut self) -> Option<u8> {
        let byte = *self.bytes.get(self.at)?;
        self.at += 1;
        Some(byte)
    }

    fn skip(&mut self, bytes: u64) -> Option<()> {
        let left = self.bytes.len() - self.at;
        let bytes = usize::try_from(bytes).ok().filter(|n| *n <= left)?;
        self.at += bytes;
        Some(())
    }

    fn varint(&mut self) -> Option<u64> {
        let mut value = 0;
        for shift in (0..64).step_by(7) {
            let byte = self.byte()?;
            value |= u64::from(byte & 0x7f) << shift;
            if byte & 0x80 == 0 {
                return Some(value);
            }
        }
        None
    }

    /// An integer that is stored as 0, -1, 1, -2, ...
    fn integer(&mut self) -> Option<i64> {
        let value = self.varint()?;
        Some((value >> 1) as i64 ^ -((value & 1) as i64))
    }

    fn fields(&mut self, path: &mut Vec<i16>, visit: Visit<'_>) -> Option<()> {
        if path.len() >= DEPTH_MAX {
            return None;
        }
        let mut field = 0_i16;
        loop {
            let head = self.byte()?;
            if head == 0 {
                return Some(());
            }
            field = match head >> 4 {
                0 => i16::try_from(self.integer()?).ok()?,
                step => field.checked_add(i16::from(step))?,
            };
            path.push(field);
            // A field's truth value is in its type.
            let kind = head & 0x0f;
            if !matches!(kind, 1 | 2) {
                self.value(kind, path, visit)?;
            }
            path.pop();
        }
    }

    fn value(&mut self, kind: u8, path: &mut Vec<i16>, visit: Visit<'_>) -> Option<()> {
        match kind {
            1..=3 => self.skip(1),
            4..=6 => {
                let value = self.integer()?;
                visit(path, value);
                Some(())
            }
            7 => self.skip(8),
            8 => {
                let length = self.varint()?;
                self.skip(length)
            }
            9 | 10 => self.list(path, visit),
            12 => self.fields(path, visit),
            // No maps in Parquet.
            _ => None,
        }
    }

    fn list(&mut self, path: &mut Vec<i16>, visit: Visit<'_>) -> Option<()> {
        let head = self.byte()?;
        let count = match head >> 4 {
            15 => self.varint()?,
            count => u64::from(count),
        };
        // Every element takes a byte at least.
        if count > (self.bytes.len() - self.at) as u64 || path.len() >= DEPTH_MAX {
            return None;
        }
        path.push(0);
        for _ in 0..count {
            self.value(head & 0x0f, path, visit)?;
        }
        path.pop();
        Some(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Head of a data page of 1000 bytes that take 20 in the file, and of a dictionary of two billion values.
    #[test]
    fn heads_of_pages_are_read_as_the_format_has_them() {
        let data = [
            0x15, 0, 0x15, 0xd0, 0x0f, 0x15, 0x28, 0x2c, 0x15, 8, 0x15, 0, 0x15, 6, 0x15, 6, 0, 0,
        ];
        let head = PageHead::read(&data).unwrap();
        let expected = PageHead {
            length: data.len(),
            uncompressed: 1000,
            compressed: 20,
            dictionary_values: None,
        };
        assert_eq!(head, expected);
        let dictionary = [
            0x15, 4, 0x15, 0x10, 0x15, 0x10, 0x4c, 0x15, 0x80, 0xd0, 0xac, 0xf3, 0x0e, 0x15, 0, 0,
            0,
        ];
        let head = PageHead::read(&dictionary).unwrap();
        assert_eq!(head.dictionary_values, Some(2_000_000_000));
        assert_eq!(PageHead::read(&data[..data.len() - 1]), None);
    }

    #[test]
    fn lists_that_are_longer_than_the_bytes_are_no_structure() {
        let walk = |bytes: &[u8]| Walk::new(bytes).structure(&mut |_, _| {});
        // Two structures without a field.
        assert_eq!(walk(&[0x29, 0x2c, 0, 0, 0]), Some(()));
        // Two billion of them.
        assert_eq!(
            walk(&[0x29, 0xfc, 0xff, 0xff, 0xff, 0xff, 7, 0, 0, 0]),
            None
        );
        // Structures in structures, without end.
        assert_eq!(walk(&[0x1c; 1000]), None);
    }
}
