// Sort the table by clicking a heading; missing values go last in either order.
const body = document.querySelector("tbody");
const headings = [...document.querySelectorAll("thead tr:last-child th")];
headings.forEach((heading, column) => heading.querySelector("button").addEventListener("click", () => {
  const up = heading.getAttribute("aria-sort") !== "ascending";
  headings.forEach(each => each.removeAttribute("aria-sort"));
  heading.setAttribute("aria-sort", up ? "ascending" : "descending");
  const key = row => row.cells[column].dataset.key;
  const compare = (a, b) => isNaN(a) || isNaN(b) ? a.localeCompare(b) : a - b;
  const none = row => ["", "–"].includes(key(row));
  [...body.rows]
    .sort((a, b) => none(a) - none(b) || (none(a) ? 0 : (up ? 1 : -1) * compare(key(a), key(b))))
    .forEach(row => body.append(row));
}));
