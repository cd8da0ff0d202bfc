//! Figures written as SVG, PNG or PDF: the ending of the name decides.
//! Uses: rsvg-convert or a browser of this machine, as processes. Never: a figure (others draw it).

use std::path::{Path, PathBuf};
use std::process::Stdio;

use clap::{Args, ValueEnum};
use tokio::process::Command;

use super::error::{CliError, CliResult};
use super::files;
use super::print::{self, PrintError};
use super::progress::shown_wait;
use crate::studies::sheet::OutputFile;

/// Program of librsvg, which needs no browser.
const CONVERTER: &str = "rsvg-convert";

/// The folder of a study's files, and the formats of its figures.
#[derive(Debug, Clone, Default, Args)]
pub struct Pictures {
    /// Folder for numbers, tables and figures.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Write each figure of --out also in these formats; needs rsvg-convert or Chromium.
    #[arg(long, value_name = "FORMAT,..", value_enum, value_delimiter = ',', requires = "out")]
    also: Vec<Format>,
}

/// Format of a figure, in addition to SVG.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Format {
    /// Pixels, two for each unit of the SVG.
    Png,
    /// A page of the size of the figure.
    Pdf,
}

impl Pictures {
    /// Writes files to a folder, and creates it; figures also in the requested formats.
    ///
    /// # Errors
    /// As [`write`].
    pub async fn write_all(&self, folder: &Path, files: &[OutputFile]) -> CliResult<()> {
        for OutputFile { name, text } in files {
            let path = folder.join(name);
            files::write(&path, text)?;
            let is_figure = path.extension().is_some_and(|ending| ending == "svg");
            for format in self.also.iter().filter(|_| is_figure) {
                write(&path.with_extension(format.ending()), text).await?;
            }
        }
        Ok(())
    }
}

impl Format {
    /// The format of a file name; `None` for SVG and unknown endings.
    fn of(path: &Path) -> Option<Self> {
        let ending = path.extension()?.to_str()?;
        Self::value_variants().iter().copied().find(|f| ending.eq_ignore_ascii_case(f.ending()))
    }

    fn ending(self) -> &'static str {
        match self {
            Self::Png => "png",
            Self::Pdf => "pdf",
        }
    }
}

/// Reads the name of a figure: an ending that no format has is refused before anything is computed.
///
/// # Errors
/// The limit, if the name ends otherwise; a name without an ending is that of an SVG.
pub fn figure_file(name: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(name);
    let is_svg = path.extension().is_none_or(|ending| ending.eq_ignore_ascii_case("svg"));
    match is_svg || Format::of(&path).is_some() {
        true => Ok(path),
        false => Err("must end in .svg, .png or .pdf".into()),
    }
}

/// Writes a figure: as PNG or PDF if the name ends like this, otherwise as SVG.
///
/// # Errors
/// `CliError::File` if the file cannot be written, `NoConverter` or `NotConverted` if it cannot be converted.
pub async fn write(path: &Path, svg: &str) -> CliResult<()> {
    let Some(format) = Format::of(path) else { return files::write(path, svg) };
    // Makes the folder, and refuses a file that cannot be written before a program starts.
    files::write(path, "")?;
    let folder = std::env::temp_dir().join(format!("palpate-figure-{}", std::process::id()));
    let converted =
        shown_wait("converting the figure", converted(&folder, svg, path, format)).await;
    let _ = std::fs::remove_dir_all(&folder);
    if converted.is_err() {
        let _ = std::fs::remove_file(path);
    }
    converted
}

async fn converted(folder: &Path, svg: &str, path: &Path, format: Format) -> CliResult<()> {
    let failed = |why: String| CliError::NotConverted { path: path.into(), why };
    let out = std::path::absolute(path).map_err(|error| failed(error.to_string()))?;
    let source = folder.join("figure.svg");
    files::write(&source, svg)?;
    let mut converter = Command::new(CONVERTER);
    converter.args(["--format", format.ending()]).arg("--output").arg(&out);
    if format == Format::Png {
        converter.args(["--zoom", "2"]);
    }
    let ended = converter.arg(&source).stdin(Stdio::null()).stdout(Stdio::null()).output().await;
    match ended {
        Ok(ended) if ended.status.success() => return Ok(()),
        Ok(ended) => {
            let said = String::from_utf8_lossy(&ended.stderr);
            return Err(failed(format!("{CONVERTER}: {}", said.trim())));
        }
        // Without it a browser converts.
        Err(_) => {}
    }
    let size_px = size_px(svg).ok_or_else(|| failed("the figure has no size".into()))?;
    let page = folder.join("figure.html");
    files::write(&page, &html(svg, size_px))?;
    let drawn = match format {
        Format::Png => print::photograph(&page, &out, size_px).await,
        Format::Pdf => print::print(&page, &out).await,
    };
    drawn.map_err(|error| match error {
        PrintError::NoBrowser => CliError::NoConverter { path: path.into() },
        other => failed(other.to_string()),
    })
}

/// Width and height in the first tag of an SVG text, px, rounded up.
fn size_px(svg: &str) -> Option<[u32; 2]> {
    let tag = svg.split_once("<svg")?.1.split_once('>')?.0;
    let side = |name: &str| -> Option<u32> {
        let value = tag.split_once(&format!(" {name}=\""))?.1.split_once('"')?.0;
        Some(value.parse::<f64>().ok()?.ceil() as u32)
    };
    Some([side("width")?, side("height")?])
}

/// A page of exactly the figure.
fn html(svg: &str, [width_px, height_px]: [u32; 2]) -> String {
    format!(
        "<!DOCTYPE html><html><head><meta charset=\"utf-8\"><style>\
         @page {{ size: {width_px}px {height_px}px; margin: 0 }}\
         html, body {{ margin: 0; background: white }} svg {{ display: block }}\
         </style></head><body>{svg}</body></html>\n"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ending_decides_and_the_page_has_the_size_of_the_figure() {
        let of = |name: &str| Format::of(Path::new(name));
        assert_eq!(
            [of("a.png"), of("a.PDF"), of("a.svg")],
            [Some(Format::Png), Some(Format::Pdf), None]
        );
        assert!(["a.SVG", "/dev/stdout", "b/a.png"].iter().all(|name| figure_file(name).is_ok()));
        assert!(figure_file("a.jpg").unwrap_err().contains(".svg, .png or .pdf"));
        let svg = "<svg width=\"720\" height=\"480.5\" viewBox=\"0 0 1 1\"><g width=\"3\"/></svg>";
        assert_eq!(size_px(svg), Some([720, 481]));
        assert!(html(svg, [720, 481]).contains("size: 720px 481px"));
        assert_eq!(size_px("no figure"), None);
    }

    #[test]
    fn without_a_converter_the_sentence_says_what_to_install() {
        let error = CliError::NoConverter { path: "plan.png".into() }.to_string();
        assert!(error.starts_with("plan.png: was not written") && error.contains("`chromium`"));
    }
}
