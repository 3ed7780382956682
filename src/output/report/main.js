
// ---------------------------------------------------------------- the page

readColors();
pageHeader();
motionSection();
if (COMPARING) {
  comparisonTables();
  imageSection();
  comparisonCharts();
} else {
  imageSection();
  timeCharts();
  moreCharts();
  iterationCharts();
  checksTable();
  factsTable();
  rawSummary();
}
clock.set(tellingInstant());
