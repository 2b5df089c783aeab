"""FMI 2.0 as this package uses it: descriptions, libraries, instances, start values, units."""
