//! Draws any egui content without a window: the same renderer and paint callbacks as on the screen, into
//! a texture that is read back as an image. Runs on software drivers as well.

use egui::accesskit;
use egui_wgpu::wgpu;
use image::RgbaImage;

/// Why a picture could not be made.
#[derive(Debug, thiserror::Error)]
pub enum OffscreenError {
    /// There is nothing to draw with.
    #[error(
        "no graphics device for drawing without a window: {0}. Install a Vulkan driver \
         (Debian: mesa-vulkan-drivers, which also works without a graphics card), and check WGPU_BACKEND if it is set"
    )]
    NoDevice(#[from] egui_wgpu::WgpuError),
    /// The picture has no pixels or more than the device can hold.
    #[error(
        "a picture of {width} x {height} pixels cannot be drawn: each side must be between 1 and {max}"
    )]
    Size {
        /// Asked for.
        width: u32,
        /// Asked for.
        height: u32,
        /// The device's limit.
        max: u32,
    },
    /// There is no such control.
    #[error("there is no control named “{0}” in the picture that could be pressed")]
    NoControl(String),
    /// The device stopped answering.
    #[error(
        "the graphics device did not deliver the picture: {0}. Try again, or another driver with WGPU_ADAPTER_NAME"
    )]
    Readback(String),
}

/// A window that nobody sees.
pub struct Offscreen {
    /// The egui context; set style and fonts here.
    pub context: egui::Context,
    /// Events for the first pass of the next [`Offscreen::render`].
    pub events: Vec<egui::Event>,
    render_state: egui_wgpu::RenderState,
    size_px: [u32; 2],
    pixels_per_point: f32,
    time_s: f64,
}

/// Passes per picture: layouts that measure themselves need two or three.
const PASSES: usize = 4;
/// Time between passes, s: animations are shorter.
const PASS_S: f64 = 0.15;

impl Offscreen {
    /// Prepares pictures of `size_px` pixels, `pixels_per_point` to a point of the layout.
    ///
    /// # Errors
    /// [`OffscreenError::NoDevice`] without any graphics driver, [`OffscreenError::Size`] for impossible sizes.
    pub fn new(size_px: [u32; 2], pixels_per_point: f32) -> Result<Self, OffscreenError> {
        let mut new = egui_wgpu::WgpuSetupCreateNew::without_display_handle();
        new.power_preference =
            wgpu::PowerPreference::from_env().unwrap_or(wgpu::PowerPreference::LowPower);
        let setup = egui_wgpu::WgpuSetup::CreateNew(new);
        let instance = pollster::block_on(setup.new_instance());
        let render_state = pollster::block_on(egui_wgpu::RenderState::create(
            &egui_wgpu::WgpuConfiguration {
                wgpu_setup: setup,
                ..Default::default()
            },
            &instance,
            None,
            egui_wgpu::RendererOptions::PREDICTABLE,
        ))?;
        let max = render_state.device.limits().max_texture_dimension_2d;
        let [width, height] = size_px;
        if !(1..=max).contains(&width) || !(1..=max).contains(&height) {
            return Err(OffscreenError::Size { width, height, max });
        }
        Ok(Self {
            context: egui::Context::default(),
            events: Vec::new(),
            render_state,
            size_px,
            pixels_per_point,
            time_s: 0.0,
        })
    }

    /// What a scene needs to draw here.
    pub fn render_state(&self) -> &egui_wgpu::RenderState {
        &self.render_state
    }

    /// Runs the content until its layout has settled and returns the picture.
    ///
    /// # Errors
    /// [`OffscreenError::Readback`] when the device fails.
    pub fn render(
        &mut self,
        mut content: impl FnMut(&mut egui::Ui),
    ) -> Result<RgbaImage, OffscreenError> {
        let mut shapes = Vec::new();
        for _ in 0..PASSES {
            let input = self.input();
            let output = self.context.run_ui(input, &mut content);
            shapes = self.apply(output);
        }
        self.read(&self.paint(shapes))
    }

    /// One pass as a window makes it, until the device has drawn it; the picture stays there.
    ///
    /// # Errors
    /// [`OffscreenError::Readback`] when the device fails.
    pub fn frame(&mut self, content: impl FnMut(&mut egui::Ui)) -> Result<(), OffscreenError> {
        let input = self.input();
        let output = self.context.run_ui(input, content);
        let shapes = self.apply(output);
        self.paint(shapes);
        let waited = self
            .render_state
            .device
            .poll(wgpu::PollType::wait_indefinitely());
        waited.map_err(|e| OffscreenError::Readback(e.to_string()))?;
        Ok(())
    }

    /// Lets time pass without a picture.
    pub fn run(&mut self, mut content: impl FnMut(&mut egui::Ui)) {
        for _ in 0..PASSES {
            let input = self.input();
            let output = self.context.run_ui(input, &mut content);
            self.apply(output);
        }
    }

    /// Presses the control of this name, as a screen reader would.
    ///
    /// # Errors
    /// [`OffscreenError::NoControl`] when none has the name, or the one that has it is off.
    pub fn press(
        &mut self,
        name: &str,
        mut content: impl FnMut(&mut egui::Ui),
    ) -> Result<(), OffscreenError> {
        self.context.enable_accesskit();
        let mut tree = None;
        for _ in 0..PASSES {
            let input = self.input();
            let mut output = self.context.run_ui(input, &mut content);
            tree = output.platform_output.accesskit_update.take();
            self.apply(output);
        }
        let nodes = tree.map_or_else(Vec::new, |t| t.nodes);
        let (id, _) = nodes
            .into_iter()
            .find(|(_, node)| {
                node.label() == Some(name)
                    && !node.is_disabled()
                    && node.supports_action(accesskit::Action::Click)
            })
            .ok_or_else(|| OffscreenError::NoControl(name.to_owned()))?;
        let request = accesskit::ActionRequest {
            action: accesskit::Action::Click,
            target_tree: accesskit::TreeId::ROOT,
            target_node: id,
            data: None,
        };
        self.events
            .push(egui::Event::AccessKitActionRequest(request));
        self.run(content);
        Ok(())
    }

    fn input(&mut self) -> egui::RawInput {
        let [width, height] = self.size_px.map(|n| n as f32 / self.pixels_per_point);
        let mut input = egui::RawInput {
            screen_rect: Some(egui::Rect::from_min_size(
                egui::Pos2::ZERO,
                egui::vec2(width, height),
            )),
            max_texture_side: Some(
                self.render_state.device.limits().max_texture_dimension_2d as usize,
            ),
            time: Some(self.time_s),
            events: std::mem::take(&mut self.events),
            ..Default::default()
        };
        if let Some(viewport) = input.viewports.get_mut(&egui::ViewportId::ROOT) {
            viewport.native_pixels_per_point = Some(self.pixels_per_point);
        }
        self.time_s += PASS_S;
        input
    }

    /// Uploads the pass's textures and returns its shapes.
    fn apply(&self, mut output: egui::FullOutput) -> Vec<egui::epaint::ClippedShape> {
        let mut renderer = self.render_state.renderer.write();
        let (device, queue) = (&self.render_state.device, &self.render_state.queue);
        #[expect(
            clippy::iter_over_hash_type,
            reason = "textures do not depend on each other"
        )]
        for (id, deltas) in output.textures_delta.set.drain() {
            for delta in deltas {
                renderer.update_texture(device, queue, id, &delta);
            }
        }
        #[expect(
            clippy::iter_over_hash_type,
            reason = "textures do not depend on each other"
        )]
        for id in output.textures_delta.free.drain() {
            renderer.free_texture(&id);
        }
        output.shapes
    }

    fn paint(&self, shapes: Vec<egui::epaint::ClippedShape>) -> wgpu::Texture {
        let (device, queue) = (&self.render_state.device, &self.render_state.queue);
        let mut renderer = self.render_state.renderer.write();
        let jobs = self.context.tessellate(shapes, self.pixels_per_point);
        let screen = egui_wgpu::ScreenDescriptor {
            size_in_pixels: self.size_px,
            pixels_per_point: self.pixels_per_point,
        };
        let texture = device.create_texture(&wgpu::TextureDescriptor {
            label: Some("offscreen window"),
            size: self.extent(),
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: self.render_state.target_format,
            usage: wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC,
            view_formats: &[],
        });
        let view = texture.create_view(&wgpu::TextureViewDescriptor::default());
        let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor {
            label: Some("offscreen window"),
        });
        let mut commands = renderer.update_buffers(device, queue, &mut encoder, &jobs, &screen);
        {
            let mut pass = encoder
                .begin_render_pass(&wgpu::RenderPassDescriptor {
                    label: Some("offscreen window"),
                    color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                        view: &view,
                        depth_slice: None,
                        resolve_target: None,
                        ops: wgpu::Operations {
                            load: wgpu::LoadOp::Clear(wgpu::Color::BLACK),
                            store: wgpu::StoreOp::Store,
                        },
                    })],
                    ..Default::default()
                })
                .forget_lifetime();
            renderer.render(&mut pass, &jobs, &screen);
        }
        commands.push(encoder.finish());
        queue.submit(commands);
        texture
    }

    fn extent(&self) -> wgpu::Extent3d {
        wgpu::Extent3d {
            width: self.size_px[0],
            height: self.size_px[1],
            depth_or_array_layers: 1,
        }
    }

    fn read(&self, texture: &wgpu::Texture) -> Result<RgbaImage, OffscreenError> {
        let (device, queue) = (&self.render_state.device, &self.render_state.queue);
        let [width, height] = self.size_px;
        // Rows are padded to a multiple of 256 bytes.
        let row = width * 4;
        let padded = row.next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT);
        let buffer = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("offscreen readback"),
            size: u64::from(padded) * u64::from(height),
            usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor {
            label: Some("offscreen readback"),
        });
        encoder.copy_texture_to_buffer(
            texture.as_image_copy(),
            wgpu::TexelCopyBufferInfo {
                buffer: &buffer,
                layout: wgpu::TexelCopyBufferLayout {
                    offset: 0,
                    bytes_per_row: Some(padded),
                    rows_per_image: None,
                },
            },
            self.extent(),
        );
        queue.submit([encoder.finish()]);
        // The outcome also shows when the range is taken below.
        buffer.map_async(wgpu::MapMode::Read, .., |_| {});
        let failed = |e: String| OffscreenError::Readback(e);
        device
            .poll(wgpu::PollType::wait_indefinitely())
            .map_err(|e| failed(e.to_string()))?;
        let bytes = buffer
            .get_mapped_range(..)
            .map_err(|e| failed(e.to_string()))?;
        let bgra = matches!(
            self.render_state.target_format,
            wgpu::TextureFormat::Bgra8Unorm | wgpu::TextureFormat::Bgra8UnormSrgb
        );
        let mut pixels = Vec::with_capacity((row * height) as usize);
        for line in bytes.chunks_exact(padded as usize) {
            for p in line[..row as usize].chunks_exact(4) {
                let [r, g, b] = if bgra {
                    [p[2], p[1], p[0]]
                } else {
                    [p[0], p[1], p[2]]
                };
                // A window is opaque.
                pixels.extend([r, g, b, 255]);
            }
        }
        RgbaImage::from_raw(width, height, pixels)
            .ok_or_else(|| failed("it has the wrong number of bytes".to_owned()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn content_fills_the_picture_and_colours_keep_their_order() {
        let mut offscreen = Offscreen::new([300, 120], 1.5).expect("a graphics driver");
        let image = offscreen
            .render(|ui| {
                let rect = ui.ctx().content_rect();
                assert_eq!(rect.size(), egui::vec2(200.0, 80.0));
                ui.painter()
                    .rect_filled(rect, 0.0, egui::Color32::from_rgb(200, 100, 50));
            })
            .expect("a picture");
        assert_eq!(image.dimensions(), (300, 120));
        for at in [(0, 0), (299, 119), (150, 60)] {
            assert_eq!(image.get_pixel(at.0, at.1).0, [200, 100, 50, 255]);
        }
    }

    #[test]
    fn a_control_is_pressed_by_its_name_unless_it_is_off() {
        let mut offscreen = Offscreen::new([300, 120], 1.0).expect("a graphics driver");
        let mut pressed = 0;
        let mut content = |ui: &mut egui::Ui| {
            pressed += u32::from(ui.button("Do it").clicked());
            ui.add_enabled(false, egui::Button::new("Not now"));
        };
        offscreen.press("Do it", &mut content).expect("it is there");
        for name in ["Not now", "Elsewhere"] {
            let error = offscreen
                .press(name, &mut content)
                .expect_err("off or away");
            assert!(error.to_string().contains(name));
        }
        assert_eq!(pressed, 1);
    }

    #[test]
    fn impossible_sizes_are_refused_with_the_limit() {
        let error = Offscreen::new([0, 100], 1.0)
            .err()
            .expect("no pixels")
            .to_string();
        assert!(
            error.contains("0 x 100") && error.contains("between 1 and"),
            "{error}"
        );
    }
}
