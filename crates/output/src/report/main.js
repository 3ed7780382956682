
// ---------------------------------------------------------------- the page

readColors();
pageHeader();
motionSection();
if (COMPARING) {
  comparisonTables();
  imageSection();
  comparisonCharts();
} else {
  adviceSection();
  barsSections();
  imageSection();
  timeCharts();
  moreCharts();
  moreTables();
  iterationCharts();
  checksTable();
  factsTable();
  rawSummary();
}
clock.set(tellingInstant());
