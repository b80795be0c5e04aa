// Return a number as text: with a minus sign, never "-0.0", and a dash if it is unknown. plus: sign of positive numbers.
function number(value, digits, unit = '', plus = '') {
  if (value === null || value === undefined || !isFinite(value)) return '\u2013';
  const text = Math.abs(value).toFixed(digits);
  return (value < 0 && +text ? '\u2212' : plus) + text + unit;
}
