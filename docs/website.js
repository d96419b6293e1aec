// What the theme's own script adds to a page gets what keyboards and screen readers need: a table or a block of code that
// is wider than the page can be focused, to scroll it by keys, and buttons of code are no landmark each.
const WIDE = ".md-typeset__scrollwrap, .md-typeset pre > code";

function amend() {
  for (const wide of document.querySelectorAll(WIDE)) wide.tabIndex = wide.scrollWidth > wide.clientWidth ? 0 : -1;
  for (const buttons of document.querySelectorAll(".md-code__nav")) buttons.setAttribute("role", "none");
}

// The script adds them when they scroll into view, so each change of the page is looked at, once before it is drawn.
let pending = 0;
function later() {
  pending ||= requestAnimationFrame(() => {
    pending = 0;
    amend();
  });
}
new MutationObserver(later).observe(document.body, { childList: true, subtree: true });
addEventListener("resize", later);
later();
