() => {
  const range = document.createRange();
  const right = (one) => one.getBoundingClientRect().right;
  range.selectNodeContents(document.querySelector("#applications .name").firstChild);
  const parts = [...document.querySelectorAll("main .panel :not(.track *)")];
  const outside = parts.filter((one) => right(one) > right(one.closest(".panel")) - 8);
  return [range.getClientRects().length, outside.map((one) => one.outerHTML)];
}
