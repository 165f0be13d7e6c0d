//! The models that come with the library.

/// A motor model that comes with the library.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Model {
    /// The maker's full name, for [`MotorParameters::named`](super::MotorParameters::named).
    pub name: &'static str,
    /// The parameter file. Its comments name the source of each figure. Start from it to write a file of your own.
    pub toml: &'static str,
}

impl Model {
    /// Whether this is its full name, or that of the maker's catalogue; case does not matter.
    pub(super) fn is_called(&self, name: &str) -> bool {
        self.name.eq_ignore_ascii_case(name) || catalogue_name(self.name).eq_ignore_ascii_case(name)
    }
}

/// A model's name as the maker's catalogue has it and drives report it: "X8-120" for the RMD-X8-P20-120.
pub(in crate::sim) fn catalogue_name(name: &str) -> String {
    let name = name.strip_prefix("RMD-").unwrap_or(name);
    match name.split_once('-').zip(name.rsplit_once('-')) {
        Some(((first, _), (_, last))) => format!("{first}-{last}"),
        None => name.to_owned(),
    }
}

/// A model of the folder `models`.
macro_rules! model {
    ($name:literal, $file:literal) => {
        Model { name: $name, toml: include_str!(concat!("../../../models/", $file)) }
    };
}

/// The models that come with the library, the smaller ones first.
pub const MODELS: [Model; 12] = [
    model!("RMD-X2-P28-7", "rmd-x2-p28-7.toml"),
    model!("RMD-X4-P12.5-10", "rmd-x4-p12.5-10.toml"),
    model!("RMD-X4-P36-36", "rmd-x4-p36-36.toml"),
    model!("RMD-X6-P8-8", "rmd-x6-p8-8.toml"),
    model!("RMD-X8-PRO", "rmd-x8-pro.toml"),
    model!("RMD-X6-P20-60", "rmd-x6-p20-60.toml"),
    model!("RMD-X10-P7-40", "rmd-x10-p7-40.toml"),
    model!("RMD-X10-P35-100", "rmd-x10-p35-100.toml"),
    model!("RMD-X8-P20-120", "rmd-x8-p20-120.toml"),
    model!("RMD-X8-P33-150", "rmd-x8-p33-150.toml"),
    model!("RMD-X12-P20-320", "rmd-x12-p20-320.toml"),
    model!("RMD-X15-P20-450", "rmd-x15-p20-450.toml"),
];
