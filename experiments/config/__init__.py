"""An experiment as a validated file; its axes and cells. Imports the floors below."""
