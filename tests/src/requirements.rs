//! The list of the manual's requirements: as text, and as a page of this documentation.

macro_rules! files {
    ($($file:literal)+) => {
        $(#[doc = include_str!(concat!("../manual/requirements/", $file, ".md"))])+
        pub mod page {}

        /// The files of `manual/requirements/`, one after the other.
        pub const TEXT: &str =
            concat!($(include_str!(concat!("../manual/requirements/", $file, ".md")), "\n",)+);
    };
}

files!("0_reading" "1_buses" "2_01_stored" "2_11_readings" "2_17_motion" "2_25_system" "3_to_9");
