// SPDX-License-Identifier: MIT
// The ECP5's PLL, as simple as a bench can do with: its clock is the one it gets.
module EHXPLLL #(
    parameter int CLKI_DIV = 1,
    parameter int CLKFB_DIV = 1,
    parameter int CLKOP_DIV = 8,
    parameter int CLKOP_CPHASE = 0
) (
    input  logic CLKI,
    input  logic CLKFB,
    input  logic PHASESEL1,
    input  logic PHASESEL0,
    input  logic PHASEDIR,
    input  logic PHASESTEP,
    input  logic PHASELOADREG,
    input  logic STDBY,
    input  logic PLLWAKESYNC,
    input  logic RST,
    input  logic ENCLKOP,
    output logic CLKOP,
    output logic LOCK
);

  if (CLKI_DIV < 1 || CLKFB_DIV < 1 || CLKOP_DIV < 1 || CLKOP_CPHASE < 0) begin : gen_illegal_divider
    $error("dividers and phase of a PLL are at least 1");
  end

  logic unused;
  assign unused = ^{CLKFB, PHASESEL1, PHASESEL0, PHASEDIR, PHASESTEP, PHASELOADREG, STDBY, PLLWAKESYNC, RST, ENCLKOP};

  // The bench's to set.
  logic locked  /* verilator public_flat_rw */;

  assign CLKOP = CLKI;
  assign LOCK  = locked;

endmodule
