// What the theme's own script adds to a page gets what keyboards and screen readers need: a table or a block of code that
// is wider than the page can be focused, to scroll it by keys, and buttons of code are no landmark each.
const WIDE = ".md-typeset__scrollwrap, .md-typeset pre > code";

function amendButtons() {
  for (const buttons of document.querySelectorAll(".md-code__nav:not([role])")) buttons.setAttribute("role", "none");
}

// Widths take a layout, and are read once before the page is drawn.
let pending = 0;
function amendWidths() {
  pending ||= requestAnimationFrame(() => {
    pending = 0;
    for (const wide of document.querySelectorAll(WIDE)) wide.tabIndex = wide.scrollWidth > wide.clientWidth ? 0 : -1;
  });
}

// The theme's script adds buttons when their code scrolls into view, so each change of the page is looked at.
new MutationObserver(() => {
  amendButtons();
  amendWidths();
}).observe(document.body, { childList: true, subtree: true });
addEventListener("resize", amendWidths);
amendButtons();
amendWidths();
