// SPDX-License-Identifier: MIT
// The design on a Radiona ULX3S: behind its USB serial port, 3 Mbaud, clocked with 75 MHz.
//
// Ports are named as the board's schematic names its nets; the FTDI chip receives on ftdi_rxd.
module pearl_ulx3s #(
    // 75 MHz / 3 Mbaud.
    parameter int unsigned CLOCKS_PER_BIT = 25
) (
    input  logic       clk_25mhz,
    input  logic       ftdi_txd,
    output logic       ftdi_rxd,
    // 0: out of reset. 1: a step has ended.
    output logic [7:0] led,
    // The ESP32's boot pin: low would restart the board's other half.
    output logic       wifi_gpio0
);

  // 25 MHz * 3; the oscillator runs 8 times as fast, at 600 MHz. The analogue settings are those that
  // Project Trellis' ecppll gives.
  logic clk, locked, rst_n;
  (* FREQUENCY_PIN_CLKI = "25", FREQUENCY_PIN_CLKOP = "75" *)
      (* ICP_CURRENT = "12", LPF_RESISTOR = "8", MFG_ENABLE_FILTEROPAMP = "1", MFG_GMCREF_SEL = "2" *)
  EHXPLLL #(
      .CLKI_DIV(1),
      .CLKFB_DIV(3),
      .CLKOP_DIV(8),
      .CLKOP_CPHASE(4)
  ) u_pll (
      .CLKI(clk_25mhz),
      .CLKFB(clk),
      .PHASESEL1(1'b0),
      .PHASESEL0(1'b0),
      .PHASEDIR(1'b1),
      .PHASESTEP(1'b1),
      .PHASELOADREG(1'b1),
      .STDBY(1'b0),
      .PLLWAKESYNC(1'b0),
      .RST(1'b0),
      .ENCLKOP(1'b0),
      .CLKOP(clk),
      .LOCK(locked)
  );

  pearl_reset u_reset (
      .clk_i  (clk),
      .ready_i(locked),
      .rst_no (rst_n)
  );

  logic irq;
  pearl_serial #(
      .CLOCKS_PER_BIT(CLOCKS_PER_BIT)
  ) u_serial (
      .clk_i (clk),
      .rst_ni(rst_n),
      .rx_i  (ftdi_txd),
      .tx_o  (ftdi_rxd),
      .irq_o (irq)
  );

  assign led = {6'b0, irq, rst_n};
  assign wifi_gpio0 = 1'b1;

endmodule
