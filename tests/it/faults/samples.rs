//! Small sound files of every kind, and hostile ones made of them: they claim more than they hold.

use std::path::Path;
use std::sync::Arc;

use arrow::array::{ArrayRef, Float64Array, RecordBatch};
use parquet::arrow::ArrowWriter;

/// What a folder holds, sorted.
pub fn names(dir: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(dir).expect("a folder");
    let mut names: Vec<String> = entries
        .map(|e| {
            e.expect("an entry")
                .file_name()
                .to_string_lossy()
                .into_owned()
        })
        .collect();
    names.sort();
    names
}

/// Two frames of one object, Vicon's segments.
pub fn vicon() -> String {
    "Segments\n200\n,,rig:arm,,,,,\nFrame,Sub Frame,RX,RY,RZ,TX,TY,TZ\n,,deg,deg,deg,mm,mm,mm\n\
     7,0,-13.8,1.3,55.7,128.5,-175.25,492\n9,0,,,,,,\n"
        .to_owned()
}

/// One rigid body over two frames, Motive.
pub fn motive() -> String {
    "Format Version,1.23,Take Name,a,Capture Frame Rate,240,Export Frame Rate,120,Rotation Type,Quaternion,\
     Length Units,Meters,Coordinate Space,Global\n\n\
     ,Type,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body\n\
     ,Name,pad,pad,pad,pad,pad,pad,pad\n,ID,1,1,1,1,1,1,1\n\
     ,,Rotation,Rotation,Rotation,Rotation,Position,Position,Position\n\
     Frame,Time (Seconds),X,Y,Z,W,X,Y,Z\n30,0.25,0,0,0,1,0.1,0.2,-0.3\n31,0.26,0,0,0,1,0.1,0.2,-0.3\n"
        .to_owned()
}

fn log_columns() -> Vec<String> {
    let mut names = vec!["t_s".to_owned()];
    names.extend((1..=6).map(|i| format!("p{i}_kpa")));
    names.extend((1..=12).map(|i| format!("spring{i}_mm")));
    let axes = ["yaw", "pitch", "roll"];
    names.extend((1..=4).flat_map(|i| axes.map(|a| format!("imu{i}_{a}_deg"))));
    names
}

fn log_of(more_names: &[&str], more_values: &[&str]) -> String {
    let mut names = log_columns();
    names.extend(more_names.iter().map(|n| (*n).to_owned()));
    let mut out = names.join(",");
    for t_s in ["0", "0.02", "0.04"] {
        let mut cells = vec![t_s];
        cells.extend(["1"; 6]);
        cells.extend(["150"; 12]);
        cells.extend(["2"; 12]);
        cells.extend(more_values);
        out.push('\n');
        out.push_str(&cells.join(","));
    }
    out.push('\n');
    out
}

/// A session's table of three samples.
pub fn session_log() -> String {
    log_of(&[], &[])
}

/// The same with motion capture.
pub fn session_log_with_truth() -> String {
    let names = ["x_mm", "y_mm", "z_mm", "yaw_deg", "pitch_deg", "roll_deg"];
    let names = names.map(|n| format!("vicon_{n}"));
    log_of(
        &names.each_ref().map(String::as_str),
        &["1", "2", "-300", "1", "2", "3"],
    )
}

/// Points `s:a`, `s:b` (and a third, nameless or `s:c`) over three frames; floats, Intel.
fn c3d_with(labels: &[&str; 3]) -> Vec<u8> {
    fn record(out: &mut Vec<u8>, group: i8, name: &str, body: &[u8]) {
        out.extend([name.len() as u8, group as u8]);
        out.extend(name.bytes());
        out.extend((body.len() as u16 + 3).to_le_bytes());
        out.extend(body);
        out.push(0);
    }
    let mut out = vec![2, 0x50];
    for v in [3u16, 0, 1, 3, 0] {
        out.extend(v.to_le_bytes());
    }
    out.extend((-0.1f32).to_le_bytes());
    out.extend(4u16.to_le_bytes());
    out.extend(0u16.to_le_bytes());
    out.extend(50f32.to_le_bytes());
    out.resize(512, 0);
    out.extend([0, 0x50, 2, 84]);
    record(&mut out, -1, "POINT", &[]);
    record(&mut out, 1, "USED", &[2, 0, 3, 0]);
    record(
        &mut out,
        1,
        "SCALE",
        &[&[4, 0][..], &(-0.1f32).to_le_bytes()].concat(),
    );
    record(&mut out, 1, "UNITS", b"\xff\x01\x02mm");
    let names = labels.concat();
    record(
        &mut out,
        1,
        "LABELS",
        &[b"\xff\x02\x04\x03", names.as_bytes()].concat(),
    );
    out.resize(3 * 512, 0);
    for n in 0..3u8 {
        for point in 0..3u8 {
            let place = [10 * point, 40 * point * point, 7 * point + n].map(f32::from);
            for v in place.into_iter().chain([0.0]) {
                out.extend(v.to_le_bytes());
            }
        }
    }
    out
}

/// Two points with labels and one without.
pub fn c3d() -> Vec<u8> {
    c3d_with(&["s:a ", "s:b ", "    "])
}

/// Three points of one subject: enough for a body.
pub fn c3d_of_three() -> Vec<u8> {
    c3d_with(&["s:a ", "s:b ", "s:c "])
}

/// A log of one IMU at rest, Parquet.
pub fn imu_log() -> Vec<u8> {
    let rows = 300;
    let constant = |v: f64| -> ArrayRef { Arc::new(Float64Array::from(vec![v; rows])) };
    let times: Vec<f64> = (0..rows).map(|k| k as f64 * 0.01).collect();
    let mut columns: Vec<(String, ArrayRef)> =
        vec![("t_s".into(), Arc::new(Float64Array::from(times)))];
    for axis in ["x", "y", "z"] {
        columns.push((format!("gyro_{axis}_rad_s"), constant(0.0)));
        let up = if axis == "z" { 9.81 } else { 0.0 };
        columns.push((format!("accel_{axis}_m_s2"), constant(up)));
    }
    for part in ["w", "x", "y", "z"] {
        let one = if part == "w" { 1.0 } else { 0.0 };
        columns.push((format!("ref_q_{part}"), constant(one)));
    }
    let batch = RecordBatch::try_from_iter(columns).expect("columns");
    let mut out = Vec::new();
    let mut writer = ArrowWriter::try_new(&mut out, batch.schema(), None).expect("a writer");
    writer.write(&batch).expect("writes");
    writer.close().expect("closes");
    out
}

const GIB: u32 = 1 << 30;

fn with(bytes: &[u8], at: usize, new: &[u8]) -> Vec<u8> {
    let mut out = bytes.to_vec();
    out[at..at + new.len()].copy_from_slice(new);
    out
}

/// Counts of points, frames and blocks that are far beyond the file.
pub fn hostile_c3d() -> Vec<Vec<u8>> {
    let whole = c3d_of_three();
    let place = |name: &[u8]| {
        let at = whole.windows(name.len()).position(|w| w == name);
        at.expect("a parameter") + name.len()
    };
    let used = place(b"USED") + 4;
    let labels = place(b"LABELS") + 2;
    vec![
        // Points: 65535 of them, in the header and in the parameter.
        with(&with(&whole, 2, &[0xff; 2]), used, &[0xff; 2]),
        // Frames 1 to 65534, and from 0 on.
        with(&whole, 6, &[1, 0, 0xfe, 0xff]),
        with(&whole, 6, &[0, 0, 0xff, 0xff]),
        // Analogue values per frame, the first block, the place of the parameters.
        with(&whole, 4, &[0xff; 2]),
        with(&whole, 16, &[0xff; 2]),
        with(&whole, 0, &[0xff]),
        // Labels of 255 × 255 × 255 characters.
        with(&whole, labels, &[0xff, 3, 0xff, 0xff, 0xff]),
    ]
}

/// Numbers beyond all sense, columns without end, a line without end.
pub fn hostile_logs() -> Vec<Vec<u8>> {
    let log = session_log();
    let long = "9".repeat(60_000);
    let columns: String = (0..15_000).map(|k| format!(",c{k}")).collect();
    vec![
        log.replace(",150,", &format!(",{long},")).into_bytes(),
        log.replace(",150,", ",1e999999999,").into_bytes(),
        log.replace("0.02", "1e300").into_bytes(),
        log.replacen('\n', &format!("{columns}\n"), 1).into_bytes(),
        vec![b'1'; 3 << 20],
        [log.as_bytes(), &vec![b','; 3 << 20]].concat(),
        vec![b'\n'; 3 << 20],
    ]
}

/// Frame numbers, rates and lines that ask for much.
pub fn hostile_tables() -> Vec<Vec<u8>> {
    vec![
        vicon().replace("\n9,0", "\n1000000000000,0").into_bytes(),
        vicon()
            .replace("\n9,0", "\n9223372036854775807,0")
            .into_bytes(),
        vicon().replace("\n200\n", "\n1e308\n").into_bytes(),
        vicon().replace("492", "1e300").into_bytes(),
        motive().replace("\n31,", "\n1000000000,").into_bytes(),
        motive().replace("120", "1e-300").into_bytes(),
        vec![b','; 3 << 20],
    ]
}

/// Numbers, nesting and texts.
pub fn hostile_tomls(whole: &str) -> Vec<Vec<u8>> {
    let put = |value: &str| {
        let name = format!("name = {value}\n");
        let rest = whole.split_once("\n").map_or("", |(_, rest)| rest);
        format!("{name}{rest}").into_bytes()
    };
    vec![
        put("1073741824"),
        put(&"9".repeat(100_000)),
        put(&"[".repeat(120_000)),
        put(&format!("{}1{}", "{a=".repeat(30_000), "}".repeat(30_000))),
        format!("{}\n", "[a.".repeat(40_000)).into_bytes(),
        format!("{whole}\n{}", "[[imus]]\n".repeat(13_000)).into_bytes(),
        put(&format!("\"{}", "x".repeat(2 << 20))),
    ]
}

/// Lengths of the header and shapes of tensors.
pub fn hostile_networks(whole: &[u8]) -> Vec<Vec<u8>> {
    let header = |text: &str| {
        let mut out = (text.len() as u64).to_le_bytes().to_vec();
        out.extend(text.bytes());
        out
    };
    let tensor = |shape: &str, end: u64| {
        header(&format!(
            r#"{{"guess":{{"dtype":"F32","shape":{shape},"data_offsets":[0,{end}]}}}}"#
        ))
    };
    let edited = |from: &str, to: &str| {
        let at = whole.windows(from.len()).position(|w| w == from.as_bytes());
        with(whole, at.expect("in the header"), to.as_bytes())
    };
    vec![
        with(whole, 0, &u64::from(GIB).to_le_bytes()),
        with(whole, 0, &u64::MAX.to_le_bytes()),
        tensor("[268435456]", u64::from(GIB)),
        tensor("[4611686018427387904,4]", 0),
        tensor("[0,1073741824]", 0),
        edited(r#"members\":5"#, r#"members\":9"#),
        header(&"[".repeat(1 << 20)),
    ]
}

/// A zigzag number of 1 GiB put in the place of every byte of the first page's head and of the footer, one after
/// the other; and lengths of the footer.
pub fn hostile_parquet(whole: &[u8]) -> Vec<Vec<u8>> {
    // Thrift's compact form of 2^30 as an i32 or an i64.
    let gib = [0x80, 0x80, 0x80, 0x80, 0x08];
    let n = whole.len();
    let length = u32::from_le_bytes(whole[n - 8..n - 4].try_into().expect("four bytes")) as usize;
    let footer = n - 8 - length;
    let mut out = vec![
        with(whole, n - 8, &GIB.to_le_bytes()),
        with(whole, n - 8, &u32::MAX.to_le_bytes()),
    ];
    for at in 4..60 {
        let tail = &whole[at + 1..];
        let mut bytes = [&whole[..at], &gib, tail].concat();
        // The page grows into what follows; the footer stays where the end says.
        bytes.drain(200..204);
        out.push(bytes);
    }
    for at in (footer..footer + length).step_by(7) {
        let mut bytes = [&whole[..at], &gib, &whole[at + 1..]].concat();
        let at = bytes.len() - 8;
        bytes[at..at + 4].copy_from_slice(&(length as u32 + 4).to_le_bytes());
        out.push(bytes);
    }
    out
}

/// Lengths of messages, and every place of a message's head and envelope.
pub fn hostile_recordings(whole: &[u8]) -> Vec<Vec<u8>> {
    let gib = u64::from(GIB).to_le_bytes();
    let mut out = vec![
        with(whole, 20, &gib),
        with(whole, 20, &u64::MAX.to_le_bytes()),
    ];
    // Places of the first messages: kind u64, length u64.
    let mut at = 12;
    for _ in 0..12 {
        let length = u64::from_le_bytes(whole[at + 8..at + 16].try_into().expect("eight bytes"));
        out.push(with(whole, at + 8, &gib));
        // The envelope's fields, and lengths within the table.
        for offset in [16, 60, 100, 140, 180, 220] {
            if offset + 5 < length as usize {
                out.push(with(whole, at + offset, &[0x80, 0x80, 0x80, 0x80, 0x04]));
                out.push(with(whole, at + offset, &GIB.to_le_bytes()));
            }
        }
        at += 16 + length as usize;
    }
    out
}
