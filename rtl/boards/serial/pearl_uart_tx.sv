// SPDX-License-Identifier: MIT
// Bytes to a serial line: a start bit, eight data bits, the lowest first, and a stop bit.
module pearl_uart_tx #(
    parameter int unsigned CLOCKS_PER_BIT = 15
) (
    input  logic       clk_i,
    input  logic       rst_ni,
    input  logic       valid_i,
    input  logic [7:0] data_i,
    output logic       ready_o,
    output logic       tx_o
);

  localparam int unsigned TIMER_BITS = $clog2(CLOCKS_PER_BIT);
  localparam logic [3:0] BITS = 4'd10;

  logic [TIMER_BITS-1:0] timer_q;
  logic [3:0] left_q;
  // What is sent next, the bit on the line lowest; behind the stop bit, the idle line.
  logic [9:0] line_q;

  assign ready_o = left_q == '0;

  always_ff @(posedge clk_i) begin
    if (!rst_ni) begin
      timer_q <= '0;
      left_q  <= '0;
      line_q  <= '1;
    end else if (ready_o) begin
      timer_q <= TIMER_BITS'(CLOCKS_PER_BIT - 1);
      if (valid_i) begin
        left_q <= BITS;
        line_q <= {1'b1, data_i, 1'b0};
      end
    end else if (timer_q == '0) begin
      timer_q <= TIMER_BITS'(CLOCKS_PER_BIT - 1);
      left_q  <= left_q - 1'b1;
      line_q  <= {1'b1, line_q[9:1]};
    end else begin
      timer_q <= timer_q - 1'b1;
    end
  end

  assign tx_o = line_q[0];

endmodule
