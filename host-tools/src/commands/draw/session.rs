//! One drawing in a terminal: its display and its keys.

use crate::commands::display::Display;
use crate::commands::operator::{Key, Operator};
use crate::error::ProgramError;
use crate::job::over_port::Show;
use crate::machine::drawing::{DrawingEnd, DrawingNews, DrawingRun};
use std::io::IsTerminal;
use std::time::Duration;

/// Time between two checks of the keyboard.
pub(super) const LOOK: Duration = Duration::from_millis(20);

/// Shows a drawing and passes on the operator's keys until the drawing has ended.
pub(super) fn attend(
    mut drawing: DrawingRun,
    operator: &mut Operator,
    mut display: Display,
) -> Result<DrawingEnd, ProgramError> {
    let end = loop {
        while let Some(key) = operator.next_key() {
            press(key, &drawing, operator, &display);
        }
        match drawing.next_within(LOOK)? {
            Some(DrawingNews::Ended(end)) => break end,
            Some(DrawingNews::Event(event)) => display.show(&Show::Event(&event)),
            Some(DrawingNews::Progress(progress)) => display.show(&Show::Progress(&progress)),
            Some(DrawingNews::Reconnected) => {
                display.say("connected again, the drawing is held: Enter resumes it, Ctrl-C ends it");
            }
            Some(DrawingNews::Lost(failure)) => {
                display.say(&format!("CONNECTION LOST: {failure}"));
                if std::io::stdin().is_terminal() {
                    display.say("the robot holds by itself; trying to connect every second, Ctrl-C gives up");
                } else {
                    display.say("the robot holds by itself; `etherpen draw --resume` continues this drawing");
                    drawing.cancel();
                }
            }
            None => {}
        }
    };
    display.finish();
    if let Err(cause) = drawing.log_end(&end) {
        eprintln!("the log of jobs cannot be written: {cause}");
    }
    Ok(end)
}

/// Carries out a key: Ctrl-C holds, a second one ends the drawing, Enter resumes.
fn press(key: Key, drawing: &DrawingRun, operator: &mut Operator, display: &Display) {
    match key {
        Key::Interrupt if drawing.has_begun() && !drawing.is_lost() && !operator.held => {
            operator.held = true;
            drawing.hold();
        }
        Key::Interrupt | Key::Terminate => {
            display.say(if drawing.has_begun() {
                "ending the drawing"
            } else {
                "ended before anything was drawn"
            });
            drawing.cancel();
        }
        Key::Enter if drawing.resume() => operator.held = false,
        Key::Enter => operator.note_early_enter(),
    }
}
