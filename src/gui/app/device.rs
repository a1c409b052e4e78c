//! The window on another graphics device.

use super::App;
use crate::gui::scene::Scene;
use crate::gui::theme::Level;

impl App {
    /// Draws on another graphics device from now on: the one before is lost with all that lay on it.
    /// `notice` is the sentence that the operator reads.
    pub fn change_device(
        &mut self,
        ctx: &egui::Context,
        render_state: Option<&egui_wgpu::RenderState>,
        notice: &str,
    ) {
        // Lets egui send the whole picture of its fonts again.
        ctx.set_glyph_rasterizers(Vec::new());
        self.screens.gap.forget_pictures();
        self.pace.drawn_by(render_state);
        let scene = &mut self.screens.operate.view3d.scene;
        match (render_state, &mut *scene) {
            (Some(rs), Some(scene)) => scene.change_device(rs),
            (rs, _) => *scene = rs.map(|rs| Scene::new(rs, &self.spec)),
        }
        self.say(notice, Level::Warning, ctx.input(|i| i.time));
    }
}
