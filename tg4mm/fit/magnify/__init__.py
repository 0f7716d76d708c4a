"""Methods of magnification over time: linear, of series and motions; by phase, of videos."""
