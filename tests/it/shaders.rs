//! Every shader is valid WGSL. The drivers would report errors only when the program runs.

use std::path::Path;

#[test]
fn every_shader_file_passes_validation() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("shaders");
    let mut names = Vec::new();
    for entry in std::fs::read_dir(&folder).expect("the folder of shaders") {
        let path = entry.expect("a folder entry").path();
        if path.extension().is_none_or(|e| e != "wgsl") {
            continue;
        }
        let name = path.display().to_string();
        let source = std::fs::read_to_string(&path).expect("a shader file");
        let module = match naga::front::wgsl::parse_str(&source) {
            Ok(module) => module,
            Err(e) => panic!("{}", e.emit_to_string_with_path(&source, &name)),
        };
        let mut validator = naga::valid::Validator::new(
            naga::valid::ValidationFlags::all(),
            naga::valid::Capabilities::default(),
        );
        if let Err(e) = validator.validate(&module) {
            panic!("{}", e.emit_to_string_with_path(&source, &name));
        }
        assert!(!module.entry_points.is_empty(), "{name} has no entry point");
        names.push(path.file_name().expect("a name").to_os_string());
    }
    names.sort();
    assert_eq!(names, ["blit.wgsl", "grid.wgsl", "line.wgsl", "mesh.wgsl"]);
}
