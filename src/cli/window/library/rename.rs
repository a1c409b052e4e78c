//! Another name for a recording, with everything that belongs to it.

use std::path::{Path, PathBuf};

use springtwin::recording::{is_later_segment, is_rrd, notes_path, segment_path};

use super::names;

/// Gives a recording another name in its folder, and returns its path then. Its further segments and the notes beside
/// it move along; the folder of a session log is renamed as a whole. Nothing is replaced: a name that is taken is
/// refused, and after a failure everything has its name from before.
pub fn rename(path: &Path, name: &str) -> Result<PathBuf, String> {
    let name = names::safe(name);
    if name.is_empty() {
        return Err("Type a name with letters or digits.".into());
    }
    let new = match path.extension().filter(|_| is_rrd(path)) {
        Some(ending) => path.with_file_name(format!("{name}.{}", ending.to_string_lossy())),
        None => path.with_file_name(&name),
    };
    if new == path {
        return Ok(new);
    }
    if is_rrd(path) && (is_later_segment(&new) || segment_path(&new, 2).exists()) {
        return Err(format!(
            "{name} names a part of another recording: type another name."
        ));
    }
    let moves = moves(path, &new);
    if let Some((_, taken)) = moves.iter().find(|(_, to)| to.exists()) {
        return Err(format!(
            "{} is there already: type another name.",
            taken.display()
        ));
    }
    reserved(path, &new, &moves)?;
    Ok(new)
}

/// What moves where, the recording itself last.
fn moves(path: &Path, new: &Path) -> Vec<(PathBuf, PathBuf)> {
    let mut moves = vec![(path.to_owned(), new.to_owned())];
    if is_rrd(path) {
        let segments = (2..).map(|n| (segment_path(path, n), segment_path(new, n)));
        moves.extend(segments.take_while(|(from, _)| from.is_file()));
        let notes = (notes_path(path), notes_path(new));
        moves.extend(Some(notes).filter(|(from, _)| from.is_file()));
    }
    moves.reverse();
    moves
}

/// Moves everything, with the new name of a file kept from others meanwhile.
fn reserved(path: &Path, new: &Path, moves: &[(PathBuf, PathBuf)]) -> Result<(), String> {
    let refused = |e: std::io::Error| {
        format!(
            "{} cannot be renamed to {} ({e}).",
            path.display(),
            new.display()
        )
    };
    let is_file = path.is_file();
    if is_file {
        std::fs::File::create_new(new).map_err(refused)?;
    }
    let Some((n, e)) = move_all(moves) else {
        return Ok(());
    };
    for (from, to) in &moves[..n] {
        if let Err(e) = std::fs::rename(to, from) {
            log::warn!("{} keeps its new name: {e}", to.display());
        }
    }
    if is_file && let Err(e) = std::fs::remove_file(new) {
        log::warn!("{} is left behind: {e}", new.display());
    }
    Err(refused(e))
}

/// How many were moved before one failed, and why; `None` when all were.
fn move_all(moves: &[(PathBuf, PathBuf)]) -> Option<(usize, std::io::Error)> {
    let mut all = moves.iter().enumerate();
    all.find_map(|(n, (from, to))| Some((n, std::fs::rename(from, to).err()?)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder(name: &str) -> PathBuf {
        let name = format!("springtwin-rename-{name}-{}", std::process::id());
        let folder = std::env::temp_dir().join(name);
        std::fs::create_dir_all(&folder).expect("folder");
        folder
    }

    fn write(folder: &Path, names: &[&str]) {
        for name in names {
            std::fs::write(folder.join(name), name).expect("written");
        }
    }

    fn names(folder: &Path) -> Vec<String> {
        let entries = std::fs::read_dir(folder).expect("folder").flatten();
        let mut all: Vec<String> = entries
            .map(|e| e.file_name().to_string_lossy().into_owned())
            .collect();
        all.sort();
        all
    }

    #[test]
    fn segments_and_notes_move_along_and_others_stay() {
        let folder = folder("along");
        write(
            &folder,
            &["a.rrd", "a_part002.rrd", "a_part003.rrd", "a.notes.toml"],
        );
        write(&folder, &["ab.rrd", "ab.notes.toml"]);
        let new = rename(&folder.join("a.rrd"), " leak: 3 ").expect("renamed");
        assert_eq!(new, folder.join("leak-3.rrd"));
        assert_eq!(
            names(&folder),
            [
                "ab.notes.toml",
                "ab.rrd",
                "leak-3.notes.toml",
                "leak-3.rrd",
                "leak-3_part002.rrd",
                "leak-3_part003.rrd"
            ]
        );
        let text = std::fs::read_to_string(folder.join("leak-3_part003.rrd"));
        assert_eq!(text.ok().as_deref(), Some("a_part003.rrd"));
        // The name that it has is no other one.
        assert_eq!(rename(&new, "leak-3"), Ok(new));
        std::fs::remove_dir_all(folder).expect("removed");
    }

    #[test]
    fn names_that_are_taken_are_refused_and_nothing_moves() {
        let folder = folder("taken");
        write(&folder, &["a.rrd", "a_part002.rrd", "a.notes.toml"]);
        write(
            &folder,
            &["b.rrd", "c.notes.toml", "d_part002.rrd", "e.rrd"],
        );
        let before = names(&folder);
        for (name, why) in [
            ("b", "is there already"),
            ("c", "is there already"),
            ("d", "a part of another recording"),
            ("e_part002", "a part of another recording"),
            ("../", "letters or digits"),
            (" ", "letters or digits"),
        ] {
            let e = rename(&folder.join("a.rrd"), name).expect_err("taken");
            assert!(e.contains(why), "{name}: {e}");
            assert_eq!(names(&folder), before, "{name}");
        }
        let text = std::fs::read_to_string(folder.join("b.rrd"));
        assert_eq!(text.ok().as_deref(), Some("b.rrd"));
        let gone = rename(&folder.join("gone.rrd"), "new").expect_err("is not there");
        assert!(gone.contains("cannot be renamed"), "{gone}");
        assert_eq!(names(&folder), before);
        std::fs::remove_dir_all(folder).expect("removed");
    }

    #[test]
    fn the_folder_of_a_session_is_renamed_as_a_whole() {
        let folder = folder("session");
        let session = folder.join("old");
        std::fs::create_dir_all(&session).expect("folder");
        write(&session, &["session.toml", "log.csv"]);
        let new = rename(&session, "new").expect("renamed");
        assert_eq!(new, folder.join("new"));
        assert_eq!(names(&new), ["log.csv", "session.toml"]);
        std::fs::remove_dir_all(folder).expect("removed");
    }
}
