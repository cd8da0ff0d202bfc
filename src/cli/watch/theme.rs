//! Colours of the screen, and what replaces them without colours: one for life, one for "look", one for
//! "act"; nothing else is coloured.
//! PURE. Uses: ratatui's styles. Never: a meaning that only a colour carries.

use ratatui::style::{Color, Modifier, Style};

use super::night::Mark;
use crate::event::Importance::{self, Act, Look, Notable, Routine};

/// Styles with or without colours.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Theme {
    /// Whether colours are used.
    pub colour: bool,
}

impl Theme {
    fn coloured(self, colour: Color) -> Style {
        if self.colour { Style::new().fg(colour) } else { Style::new() }
    }

    /// Returns the style of what runs.
    pub fn life(self) -> Style {
        self.coloured(Color::Green)
    }

    /// Data of a virtual rig.
    pub fn virtual_rig(self) -> Style {
        self.coloured(Color::Magenta)
    }

    /// Titles and other text around the values.
    pub fn aside(self) -> Style {
        self.coloured(Color::DarkGray)
    }

    /// Values that are old.
    pub fn old(self) -> Style {
        let style = Style::new().remove_modifier(Modifier::BOLD | Modifier::REVERSED);
        if self.colour {
            style.fg(Color::DarkGray).bg(Color::Reset)
        } else {
            style.add_modifier(Modifier::DIM)
        }
    }

    /// Text by how much it matters.
    pub fn level(self, level: Importance) -> Style {
        match level {
            Routine | Notable => Style::new(),
            Look => self.coloured(Color::Yellow).add_modifier(Modifier::BOLD),
            Act if self.colour => {
                let style = Style::new().fg(Color::White).bg(Color::Red);
                style.add_modifier(Modifier::BOLD)
            }
            Act => Style::new().add_modifier(Modifier::BOLD | Modifier::REVERSED),
        }
    }

    /// Bar of a force, by its share of the limit.
    pub fn force(self, share: f64) -> Style {
        match share {
            1.0.. => self.coloured(Color::Red),
            0.8.. => self.coloured(Color::Yellow),
            _ => self.life(),
        }
    }

    /// Colour of a configuration on the map; `None` if it is not drawn without colours.
    pub fn mark(self, mark: Mark) -> Option<Color> {
        if !self.colour {
            return (mark != Mark::Later).then_some(Color::Reset);
        }
        Some(match mark {
            Mark::Later => Color::DarkGray,
            Mark::Done => Color::Green,
            Mark::Failed => Color::Yellow,
            Mark::Skipped => Color::Red,
            Mark::Next | Mark::Now => Color::White,
        })
    }

    /// Colour of the outline of the skin and its electrodes.
    pub fn outline(self) -> Color {
        if self.colour { Color::Gray } else { Color::Reset }
    }
}
