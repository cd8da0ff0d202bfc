//! The result of a study: text, numbers, files.
//! PURE. Never: a file on the disk (the caller writes them).

use serde_json::Value;

/// A completed table or figure.
#[derive(Debug, Clone, PartialEq)]
pub struct Sheet {
    /// Text for people, Markdown.
    pub text: String,
    /// Numbers for scripts, a JSON object.
    pub numbers: Value,
    /// Text, numbers and figures as files.
    pub files: Vec<OutputFile>,
}

/// A text file of a result.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OutputFile {
    /// Name of the file, without a folder.
    pub name: String,
    /// Contents: Markdown, JSON, CSV or SVG.
    pub text: String,
}

impl OutputFile {
    /// A file with this name and text.
    pub fn new(name: impl Into<String>, text: String) -> Self {
        Self { name: name.into(), text }
    }
}

impl Sheet {
    /// A result whose files are its text (`md`) and numbers (`json`), both called `name`, and the
    /// figures.
    pub fn new(name: &str, text: String, numbers: Value, figures: Vec<OutputFile>) -> Self {
        let mut files = vec![
            OutputFile::new(format!("{name}.md"), text.clone()),
            OutputFile::new(format!("{name}.json"), format!("{numbers:#}\n")),
        ];
        files.extend(figures);
        Self { text, numbers, files }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sheet_has_its_text_and_numbers_as_files_before_the_figures() {
        let figure = OutputFile::new("fig-9.svg", "<svg/>".into());
        let sheet = Sheet::new("table-iv", "# IV".into(), serde_json::json!(1), vec![figure]);
        let names: Vec<&str> = sheet.files.iter().map(|file| file.name.as_str()).collect();
        assert_eq!(names, [concat!("table-iv", ".md"), "table-iv.json", "fig-9.svg"]);
        assert_eq!(sheet.files[1].text, "1\n");
    }
}
