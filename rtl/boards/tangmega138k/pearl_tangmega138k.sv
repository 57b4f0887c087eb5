// SPDX-License-Identifier: MIT
// The design on a Sipeed Tang Mega 138K: behind its USB serial port, clocked with its oscillator's 50 MHz, since
// the free tools cannot configure a PLL of this part.
module pearl_tangmega138k #(
    // 50 MHz / 17 is 2 % less than 3 Mbaud: the ends of a line may differ by more.
    parameter int unsigned CLOCKS_PER_BIT = 17
) (
    input  logic       clk_50mhz,
    // A key of the dock, which resets the design.
    input  logic       key_n,
    input  logic       uart_rx,
    output logic       uart_tx,
    // On PMOD 0. 0: out of reset. 1: a step has ended.
    output logic [1:0] led
);

  logic rst_n, irq;

  pearl_reset u_reset (
      .clk_i  (clk_50mhz),
      .ready_i(key_n),
      .rst_no (rst_n)
  );

  pearl_serial #(
      .CLOCKS_PER_BIT(CLOCKS_PER_BIT)
  ) u_serial (
      .clk_i (clk_50mhz),
      .rst_ni(rst_n),
      .rx_i  (uart_rx),
      .tx_o  (uart_tx),
      .irq_o (irq)
  );

  assign led = {irq, rst_n};

endmodule
