// Return a number as text: with a minus sign, never "-0.0", and a dash if it is unknown.
// digits: decimals, by default as many as it has. plus: sign of numbers from 0 on.
function number(value, digits, unit = '', plus = '') {
  if (value === null || value === undefined || !isFinite(value)) return '\u2013';
  const text = digits === undefined ? String(+Math.abs(value).toPrecision(10)) : Math.abs(value).toFixed(digits);
  return (value < 0 && +text ? '\u2212' : plus) + text + unit;
}
