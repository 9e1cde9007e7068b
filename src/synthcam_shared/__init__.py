"""Shared by the three packages: errors, command lines, files, settings, jobs, report pages."""
