//! The window: winit's events become navigation, frames and a status line.

use anyhow::{Context, Result};
use pb_lod::plan::Detail;
use pb_lod::progressive_buffers::model::Model;
use pb_render::{ColorMode, Gpu, Style, Surface};
use std::sync::Arc;
use std::time::Instant;
use winit::application::ApplicationHandler;
use winit::event::{DeviceEvent, DeviceId, ElementState, MouseButton, MouseScrollDelta, WindowEvent};
use winit::event_loop::{ActiveEventLoop, ControlFlow, EventLoop};
use winit::keyboard::{KeyCode, PhysicalKey};
use winit::window::{CursorGrabMode, Window, WindowId};

use crate::args::Args;
use crate::failure::Outcome;
use crate::feed::DiskClock;
use crate::flypath::{Flypath, Keyframe};
use crate::frame_rate::FrameRate;
use crate::navigate::{Mode, Navigator, Push};
use crate::overlay::Overlay;
use crate::prefetch::Prefetcher;
use crate::screen::{Next, Screen};
use crate::size::show_bytes;
use crate::stage::Stage;
use crate::stats::{Line, ProcessMemory, StatsFile};
use crate::streaming::{Moment, open_model, subject};

/// Vertical field of view by hand, degrees.
const FOV_DEG: f64 = 50.0;
/// Seconds between two updates of the status line.
const STATUS_SECS: f64 = 0.25;
/// Seconds between two recorded keyframes.
const RECORD_SECS: f64 = 0.1;
/// Longest step that residency floors and flying make in one frame, seconds: a stall is no jump.
const MAX_DT_SECS: f64 = 0.1;
/// Factor of one press of [ or ].
const DETAIL_STEP: f32 = 1.25;

/// Opens the window and runs until it is closed.
pub fn run(args: Args) -> Result<Outcome> {
    let flight = args.flypath.as_deref().map(Flypath::open).transpose()?;
    let model = open_model(&args.archive)?;
    let events = EventLoop::new().context(
        "no window system was found; use --headless, or start the program where a display is (DISPLAY or \
         WAYLAND_DISPLAY)",
    )?;
    events.set_control_flow(ControlFlow::Wait);
    let mut app = App { args, flight, model: Some(model), shown: None, result: Ok(Outcome::Done) };
    events.run_app(&mut app).context("the window system failed")?;
    app.result
}

struct App {
    args: Args,
    flight: Option<Flypath>,
    /// Until the window is there.
    model: Option<Arc<Model>>,
    shown: Option<Shown>,
    result: Result<Outcome>,
}

impl App {
    fn stop(&mut self, events: &ActiveEventLoop, error: anyhow::Error) {
        self.result = Err(error);
        events.exit();
    }
}

impl ApplicationHandler for App {
    fn resumed(&mut self, events: &ActiveEventLoop) {
        let Some(model) = self.model.take() else { return };
        match Shown::new(events, &self.args, model, self.flight.take()) {
            Ok(shown) => self.shown = Some(shown),
            Err(error) => self.stop(events, error),
        }
    }

    fn window_event(&mut self, events: &ActiveEventLoop, _: WindowId, event: WindowEvent) {
        let Some(shown) = &mut self.shown else { return };
        match shown.event(&event) {
            Ok(true) => {}
            Ok(false) => {
                self.result = shown.finish(&self.args);
                events.exit();
            }
            Err(error) => self.stop(events, error),
        }
    }

    fn device_event(&mut self, _: &ActiveEventLoop, _: DeviceId, event: DeviceEvent) {
        if let (Some(shown), DeviceEvent::MouseMotion { delta }) = (&mut self.shown, event) {
            shown.look(delta);
        }
    }
}

/// A flight that is being played.
struct Playing {
    flight: Flypath,
    t_secs: f64,
    paused: bool,
}

/// All that lives as long as the window.
struct Shown {
    window: Arc<Window>,
    gpu: Gpu,
    screen: Screen,
    stage: Stage,
    overlay: Overlay,
    navigator: Navigator,
    playing: Option<Playing>,
    recorded: Option<Vec<Keyframe>>,
    style: Style,
    detail: Detail,
    prefetcher: Prefetcher,
    frame_rate: FrameRate,
    push: Push,
    buttons: Buttons,
    clock: Clock,
    stats: Option<StatsFile>,
}

/// Which mouse buttons are down, and where the pointer was.
#[derive(Default)]
struct Buttons {
    turn: bool,
    pan: bool,
    at: Option<(f64, f64)>,
}

struct Clock {
    start: Instant,
    last: Instant,
    status: Instant,
    /// Since the status line was set, and since the start.
    frames: u32,
    all_frames: u32,
}

impl Shown {
    fn new(events: &ActiveEventLoop, args: &Args, model: Arc<Model>, flight: Option<Flypath>) -> Result<Self> {
        let size = winit::dpi::PhysicalSize::new(args.size[0], args.size[1]);
        let attributes = Window::default_attributes().with_title("pb-view").with_inner_size(size);
        let window = Arc::new(events.create_window(attributes).context("the window cannot be opened")?);
        let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle_from_env());
        let surface = instance.create_surface(window.clone()).context("the window cannot be drawn to")?;
        let mut gpu = Gpu::open(instance, Some(&surface))?;
        gpu.texture_blocks = args.textures.blocks(&gpu);
        let screen = Screen::new(&gpu, surface, window.inner_size().into(), args.samples)?;
        let subject = subject(&model, args.up.vector());
        let mut stage = Stage::new(&gpu, model, args.bounds(), screen.format())?;
        if let Some(disk) = args.disk_model {
            stage.streaming.feed.set_disk(disk, DiskClock::Wall);
        }
        stage.streaming.pace_uploads();
        let mut navigator = Navigator::new(subject, FOV_DEG);
        navigator.fit(screen.aspect());
        let now = Instant::now();
        if args.wireframe && !gpu.wireframe {
            eprintln!("pb-view: warning: the graphics adapter cannot draw lines; surfaces are drawn filled");
        }
        Ok(Self {
            overlay: Overlay::new(&gpu, screen.format().color),
            window,
            gpu,
            screen,
            stage,
            navigator,
            playing: flight.map(|flight| Playing { t_secs: flight.time(0), flight, paused: false }),
            recorded: args.record.as_ref().map(|_| Vec::new()),
            style: args.style(),
            detail: args.detail(),
            prefetcher: args.prefetcher(),
            frame_rate: FrameRate::new(args.target_fps),
            push: Push::default(),
            buttons: Buttons::default(),
            clock: Clock { start: now, last: now, status: now, frames: 0, all_frames: 0 },
            stats: args.stats.as_deref().map(StatsFile::create).transpose()?,
        })
    }

    /// False when the window is to be closed.
    fn event(&mut self, event: &WindowEvent) -> Result<bool> {
        match event {
            WindowEvent::CloseRequested => return Ok(false),
            WindowEvent::Resized(size) => self.screen.resize(&self.gpu, (*size).into()),
            WindowEvent::RedrawRequested => self.frame()?,
            WindowEvent::KeyboardInput { event, .. } => {
                if let PhysicalKey::Code(code) = event.physical_key {
                    let pressed = event.state == ElementState::Pressed;
                    if pressed && code == KeyCode::Escape {
                        return Ok(false);
                    }
                    self.key(code, pressed, event.repeat);
                }
            }
            WindowEvent::MouseInput { state, button, .. } => self.button(*button, *state == ElementState::Pressed),
            WindowEvent::CursorMoved { position, .. } => self.pointer(position.x, position.y),
            WindowEvent::MouseWheel { delta, .. } => {
                let notches = match delta {
                    MouseScrollDelta::LineDelta(_, y) => *y as f64,
                    MouseScrollDelta::PixelDelta(p) => p.y / 60.0,
                };
                self.take_over();
                self.navigator.wheel(notches);
            }
            _ => return Ok(true),
        }
        if !matches!(event, WindowEvent::RedrawRequested) {
            self.window.request_redraw();
        }
        Ok(true)
    }

    fn button(&mut self, button: MouseButton, pressed: bool) {
        match button {
            MouseButton::Left => self.buttons.turn = pressed,
            MouseButton::Right | MouseButton::Middle => self.buttons.pan = pressed,
            _ => {}
        }
    }

    fn pointer(&mut self, x: f64, y: f64) {
        let last = self.buttons.at.replace((x, y));
        let Some((dx, dy)) = last.map(|(a, b)| (x - a, y - b)) else { return };
        if self.navigator.mode == Mode::Fly || !(self.buttons.turn || self.buttons.pan) {
            return; // flying looks around by raw motion
        }
        self.take_over();
        match self.buttons.turn {
            true => self.navigator.turn(dx, dy),
            false => self.navigator.pan(dx, dy, self.screen.canvas.size[1] as f64),
        }
    }

    /// Raw mouse motion.
    fn look(&mut self, (dx, dy): (f64, f64)) {
        if self.navigator.mode == Mode::Fly && self.window.has_focus() && self.playing.is_none() {
            self.navigator.turn(dx * 0.5, dy * 0.5);
            self.window.request_redraw();
        }
    }

    /// The hand takes over from a flight that is being played.
    fn take_over(&mut self) {
        if let Some(playing) = self.playing.take() {
            self.navigator.take(&playing.flight.at(playing.t_secs));
        }
    }

    fn key(&mut self, code: KeyCode, pressed: bool, repeat: bool) {
        let value = if pressed { 1.0 } else { 0.0 };
        match code {
            KeyCode::KeyW | KeyCode::ArrowUp => self.push.forward = value,
            KeyCode::KeyS | KeyCode::ArrowDown => self.push.forward = -value,
            KeyCode::KeyD | KeyCode::ArrowRight => self.push.right = value,
            KeyCode::KeyA | KeyCode::ArrowLeft => self.push.right = -value,
            KeyCode::KeyE => self.push.up = value,
            KeyCode::KeyQ => self.push.up = -value,
            KeyCode::ShiftLeft | KeyCode::ShiftRight => self.push.fast = pressed,
            _ if pressed && !repeat => self.command(code),
            _ => {}
        }
    }

    fn command(&mut self, code: KeyCode) {
        match code {
            KeyCode::KeyF => {
                self.take_over();
                self.navigator.fit(self.screen.aspect());
            }
            KeyCode::Tab | KeyCode::KeyC => {
                self.take_over();
                self.navigator.toggle();
                self.grab();
            }
            KeyCode::Digit1 => self.style.color = ColorMode::Shaded,
            KeyCode::Digit2 => self.style.color = ColorMode::Level,
            KeyCode::Digit3 => self.style.color = ColorMode::Cluster,
            KeyCode::Digit4 => self.style.color = ColorMode::Triangle,
            KeyCode::Digit5 => self.style.color = ColorMode::Albedo,
            KeyCode::Digit6 => self.style.color = ColorMode::Normals,
            KeyCode::Digit7 => self.style.color = ColorMode::Mips,
            KeyCode::Digit8 => self.style.color = ColorMode::Texels,
            KeyCode::Digit9 => self.style.color = ColorMode::Checker,
            KeyCode::KeyL if self.gpu.wireframe => self.style.wireframe = !self.style.wireframe,
            KeyCode::KeyL => eprintln!("pb-view: the graphics adapter cannot draw lines"),
            KeyCode::BracketLeft => self.scale_detail(DETAIL_STEP),
            KeyCode::BracketRight => self.scale_detail(1.0 / DETAIL_STEP),
            KeyCode::Space => {
                if let Some(playing) = &mut self.playing {
                    playing.paused = !playing.paused;
                }
            }
            _ => {}
        }
    }

    /// `[` allows more error (or, with bands, nearer switches), `]` less.
    fn scale_detail(&mut self, factor: f32) {
        self.detail = match self.detail {
            Detail::ErrorPx(tau) => Detail::ErrorPx((tau * factor).clamp(1e-2, 1e3)),
            Detail::Bands { k, s } => Detail::Bands { k: k / factor, s },
        };
    }

    /// The pointer is held and hidden while flying, where the window system allows it.
    fn grab(&mut self) {
        let fly = self.navigator.mode == Mode::Fly;
        let mode = if fly { CursorGrabMode::Locked } else { CursorGrabMode::None };
        if self.window.set_cursor_grab(mode).is_err() && fly {
            // Without a grab the raw motion still arrives while the pointer is inside.
            let _ = self.window.set_cursor_grab(CursorGrabMode::Confined);
        }
        self.window.set_cursor_visible(!fly);
        self.buttons.at = None;
    }

    fn frame(&mut self) -> Result<()> {
        let start = Instant::now();
        let picture = match self.screen.next(&self.gpu, self.window.inner_size().into())? {
            Next::Picture(picture) => picture,
            Next::Later => {
                self.window.request_redraw();
                return Ok(());
            }
            Next::Hidden => return Ok(()),
        };
        let now = Instant::now();
        let dt_secs = (now - self.clock.last).as_secs_f64().min(MAX_DT_SECS);
        self.clock.last = now;
        let key = self.camera(dt_secs);
        self.record(key);
        let size = self.screen.canvas.size;
        let detail = self.frame_rate.detail(self.detail);
        let moment = Moment { key, size, detail, dt_secs: dt_secs as f32 };
        let flight = self.playing.as_ref().map(|p| (&p.flight, p.t_secs));
        let streaming = &mut self.stage.streaming;
        streaming.expect(self.prefetcher.expect(&key, dt_secs, flight, streaming.latency()));
        self.stage.advance(&self.gpu, &moment);
        let color = picture.texture.create_view(&Default::default());
        let surface = Surface { color: &color, canvas: &self.screen.canvas };
        let drawing = Instant::now();
        self.stage.draw(&self.gpu, &surface, &moment, self.style);
        let draw_ms = drawing.elapsed().as_secs_f64() * 1e3;
        self.status(now);
        self.overlay.draw(&self.gpu, &color, size);
        self.window.pre_present_notify();
        self.gpu.queue.present(picture);
        if self.frame_rate.is_on() {
            // The time of the whole frame, without the wait for the screen.
            self.gpu.wait()?;
            let drawn = self.stage.streaming.detail(&moment);
            self.frame_rate.add(now.elapsed().as_secs_f64(), dt_secs, self.detail, drawn);
        }
        self.write_stats(start, draw_ms)?;
        let moving = self.push != Push { fast: self.push.fast, ..Push::default() };
        let flying = self.playing.as_ref().is_some_and(|p| !p.paused);
        if moving || flying || !self.stage.streaming.settled() {
            self.window.request_redraw();
        }
        Ok(())
    }

    /// A line of --stats: the frame's time is that from asking for a picture to draw into to handing it over.
    fn write_stats(&mut self, start: Instant, draw_ms: f64) -> Result<()> {
        let frame = self.clock.all_frames;
        self.clock.all_frames += 1;
        let Some(file) = &mut self.stats else { return Ok(()) };
        let (t_secs, frame_ms) = ((start - self.clock.start).as_secs_f64(), start.elapsed().as_secs_f64() * 1e3);
        let (memory, stats) = (ProcessMemory::now(), self.stage.stats());
        file.add(&Line { frame, t_secs, frame_ms, draw_ms, cut: frame == 0, memory, stats })
    }

    /// The camera of this frame: from the flight, or from the hand.
    fn camera(&mut self, dt_secs: f64) -> Keyframe {
        if let Some(playing) = &mut self.playing {
            if !playing.paused {
                playing.t_secs += dt_secs;
            }
            let key = playing.flight.at(playing.t_secs);
            if playing.t_secs >= playing.flight.time(0) + playing.flight.duration_secs() {
                self.take_over();
            }
            return key;
        }
        self.navigator.fly(self.push, dt_secs);
        self.navigator.keyframe(0.0)
    }

    fn record(&mut self, key: Keyframe) {
        let Some(recorded) = &mut self.recorded else { return };
        let t = (Instant::now() - self.clock.start).as_secs_f64();
        if recorded.last().is_none_or(|last| t - last.t >= RECORD_SECS) {
            recorded.push(Keyframe { t, ..key });
        }
    }

    fn status(&mut self, now: Instant) {
        self.clock.frames += 1;
        let secs = (now - self.clock.status).as_secs_f64();
        if secs < STATUS_SECS {
            return;
        }
        let fps = self.clock.frames as f64 / secs;
        let s = self.stage.stats();
        let mode = if self.navigator.mode == Mode::Fly { "  fly" } else { "" };
        let line = format!(
            "{fps:.0} fps  {:.2} M triangles  {} draws  VRAM {}  RAM {}  error {:.2} px  {} missing{mode}",
            s.triangles as f64 / 1e6,
            s.draws,
            show_bytes(s.vram_bytes),
            show_bytes(s.ram_bytes),
            s.error_px,
            s.missing_chunks
        );
        self.overlay.set(&self.gpu, &line);
        self.window.set_title(&format!("pb-view  {line}"));
        (self.clock.status, self.clock.frames) = (now, 0);
    }

    /// Writes what was recorded.
    fn finish(&mut self, args: &Args) -> Result<Outcome> {
        if let (Some(path), Some(keys)) = (&args.record, self.recorded.take()) {
            if keys.is_empty() {
                anyhow::bail!("{}: nothing was flown, so no flypath was written", path.display());
            }
            let t0 = keys[0].t;
            let keys = keys.into_iter().map(|k| Keyframe { t: k.t - t0, ..k }).collect();
            let flight = Flypath::new(60.0, keys).map_err(|e| anyhow::anyhow!("the path flown is no flypath: {e}"))?;
            flight.write(path)?;
        }
        if let Some(stats) = self.stats.take() {
            stats.finish()?;
        }
        Ok(if self.stage.streaming.damaged_chunks() == 0 { Outcome::Done } else { Outcome::Damaged })
    }
}
